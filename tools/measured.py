"""The measurements behind the documentation's tables: commands, stored numbers, tables."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from itertools import product
from typing import Any, NamedTuple

from app.control.controller import CONTROLLERS
from benchmarks.gallery import ROBOTS as GALLERY
from benchmarks.peers.names import PEERS
from benchmarks.peers.table import markdown as peers_table

Figures = Mapping[str, Any]

LINES = ("guiding-lateral", "guiding-front", "guiding-above", "guiding-fold", "tracking")
COMPARED = ("none", "repulsive", "barrier", "hqp", "dbb")
"""Methods of the tables."""
PLANTS = {"planar": "pybullet", "mujoco": "MuJoCo", "mujoco-contact": "MuJoCo, wheels"}
ENGINE_RUNS = {
    "husky_panda": (*LINES, "refrigerator"),
    "husky_ur5": ("guiding-lateral", "guiding-front", "tracking"),
    "frankie": ("guiding-lateral", "guiding-front", "tracking"),
}
"""Scenarios by robot; other robots than the paper's need the extra `robots`."""
DISTURBANCES = {
    "none": (),
    "encoder noise 1 mrad": ("--encoder-noise", "0.001"),
    "base delay 0.2 s": ("--base-delay", "0.2"),
    "masses 20 % too large": ("--mass-error", "0.2"),
    "masses 20 % too small": ("--mass-error", "-0.2"),
    "slip 20 %": ("--slip", "0.2"),
}
ROBOTS = (
    "husky_panda",
    "husky_ur5",
    "stretch_se3",
    "tiago",
    "frankie",
    "frankie_omni",
    "racecar_panda",
)
MODELLED = (
    *("--hand-mass", "0", "0", "--base-delay", "0", "0", "--mass-error", "0", "0"),
    *("--slip", "0", "0", "--v-max", "0.5", "0.5", "--payload", "0", "0"),
)
"""Options of all studies: robot and base agree with their models, without a payload."""
EXACT = (
    *("--hand-stiffness", "300", "2000", "--encoder-noise", "0", "0"),
    *("--speed", "0.3", "1.2", "--faulty", "0", *MODELLED),
)
"""Options of the studies of pulls: also no noise and no faults."""
PULLS = ("--cases", "690", "--seed", "17", "--hand-f-max", "30", "100", *EXACT)
"""Options of the study of pulls with up to 100 N."""
ENVELOPE = ("--cases", "20000", "--seed", "1", "--hand-f-max", "30", "50", *EXACT)
"""Options of the study from which the stated envelope is fitted; it takes two hours."""
FAULTY = (
    *("--cases", "2000", "--seed", "5", "--hand-f-max", "5", "36", "--duration", "5"),
    *("--faulty", "1", "--encoder-noise", "0", "0.0003", *MODELLED),
)
"""Options of the study of random faults."""
_OF_FAULTS = {
    "cases": "runs",
    "contact": "contact of arm and base",
    "bodies_overlap": "convex bodies of arm and base met",
    "without_readings": "no usable reading for 0.1 s",
    "too_fast": "a joint above 1.05 of its speed limit, no torque at its limit",
    "too_fast_without_floor_contact": "of these, without a contact with the floor",
    "too_fast_with_readings": "of these, with a usable reading at least each 0.1 s",
}
"""Counts of the study of random faults, and their titles."""


TRUST = {
    "messages": (4, ("benchmarks.fuzz", "--what", "messages", "--count", "25000")),
    "files": (10, ("benchmarks.fuzz", "--what", "files", "--count", "1000")),
    "faults": (12, ("benchmarks.faults", "--tries", "18")),
}
"""Long measurements: number of parts, each with its own seed, and the command of a part."""


MUTANTS = ("--count", "50", "--json")
"""Options of one of the four commands that together test 200 mutants."""


class ResultSet(NamedTuple):
    """The content of one file of docs/results, and of one table.

    Attributes:
        runs: Arguments after `python -m` of a command that prints JSON, by the name of the row.
        keep: Selects the stored numbers from the output.
        table: Markdown of the numbers by the names of their rows; some rows may be missing.
        default: Whether the set is measured if no set is named. It is False, for example, for a
            set that needs a browser or a package index.
    """

    runs: Mapping[str, Sequence[str]]
    keep: Callable[[dict[str, Any]], Any]
    table: Callable[[Figures], str]
    default: bool = True


def grid(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A Markdown table."""
    lines = [list(head), ["---"] * len(head), *map(list, rows)]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def metres(value: float | None) -> str:
    """A length in metres with three decimals and a true minus; empty without a value."""
    return "" if value is None else f"{value:.3f} m".replace("-", "−")


def millimetres(value: float | None) -> str:
    """A length in millimetres, with one decimal below 10 mm; empty without a value."""
    if value is None:
        return ""
    digits = 1 if abs(value) < 0.00995 else 0
    return f"{1e3 * value:.{digits}f} mm".replace("-", "−")


def number(value: float | None, unit: str = "", digits: int = 3) -> str:
    """A number with significant digits and unit; empty without a value."""
    if value is None:
        return ""
    text = f"{value:.{digits}g}" if abs(value) < 10**digits else f"{value:.0f}"
    return f"{text} {unit}".strip().replace("-", "−")


def run(scenario: str, *options: str) -> tuple[str, ...]:
    """Arguments after `python -m` that run a scenario by `dbb run`."""
    return ("app", "run", scenario, *options, "--json")


def keep_run(printed: dict[str, Any]) -> dict[str, Any]:
    """The displayed numbers of a run.

    The smallest distance is that between arm and base; for `guiding-fold` it is that between links
    of the arm, for `refrigerator` that between base and door.
    """
    least = {"guiding-fold": "arm_min_clearance_m", "refrigerator": "door_min_distance_m"}
    return {
        "least_distance_m": printed[least.get(printed["scenario"], "min_clearance_m")],
        "off_m": printed["ee_error_final_m"],
        "contacts": printed["contacts"] + printed["arm_contacts"],
        "base_moved_m": printed["base_displacement_m"],
        "solver_failures": printed["solver_failures"],
        "opened_s": printed.get("door_opened_80deg_at_s"),
    }


def run_cell(row: Mapping[str, Any] | None) -> str:
    """A cell with the smallest distance, the final error of the end-effector, and any contact.

    If a door has reached an opening of 80°, the time at which it did so replaces the error. The
    cell of a run that was not measured is empty.
    """
    if row is None:
        return ""
    end = f"error {millimetres(row['off_m'])}"
    if row["opened_s"] is not None:
        end = f"80° open at {row['opened_s']:.1f} s"
    touched = ", **contact**" if row["contacts"] else ""
    return f"{metres(row['least_distance_m'])}, {end}{touched}"


def scenarios_table(found: Figures) -> str:
    """A row per scenario, a column per controller."""
    rows = []
    for scenario in (*LINES, "refrigerator"):
        moved = found.get(f"{scenario} dbb", {}).get("base_moved_m")
        cells = [run_cell(found.get(f"{scenario} {name}")) for name in COMPARED]
        rows.append([f"`{scenario}`", *cells, "" if moved is None else f"{moved:.2f} m"])
    return grid(["scenario", *(f"`{name}`" for name in COMPARED), "base displacement, `dbb`"], rows)


def disturbances_table(found: Figures) -> str:
    """A row per disturbance, a column per scenario."""
    names = ("guiding-lateral", "guiding-front", "tracking")
    rows = [[d, *(run_cell(found.get(f"{s} {d}")) for s in names)] for d in DISTURBANCES]
    return grid(["disturbance", *(f"`{name}`" for name in names)], rows)


def engines_table(found: Figures) -> str:
    """A row per robot and scenario, a column per plant."""
    rows = [
        [
            f"`{robot}`, `{scenario}`",
            *(run_cell(found.get(f"{robot} {scenario} {plant}")) for plant in PLANTS),
        ]
        for robot, names in ENGINE_RUNS.items()
        for scenario in names
    ]
    return grid(["robot, scenario", *PLANTS.values()], rows)


def plants_table(found: Figures) -> str:
    """A row per plant."""
    times, study = found["times"]["times_us"], found["times"]["study"]
    first = {key: times["planar"][key] for key in ("median", "least")}
    rows = []
    for n, t in times.items():
        cells = [f"{t['median']:.1f} µs, {t['least']:.1f} µs"]
        cells.append(f"{t['median'] / first['median']:.2f}, {t['least'] / first['least']:.2f}")
        if n in study:
            cells.append(f"{study[n]:.0f} s, {study['planar'] / study[n]:.2f} times as fast")
        rows.append([f"`{n}`", *cells, *[""] * (3 - len(cells))])
    taken = f"`dbb study` of {study['cases']} cases"
    head = ["plant", "step, reading, contacts: median, minimum", "ratio to pybullet", taken]
    return grid(head, rows)


def robots_table(found: Figures) -> str:
    """A row per robot, case and controller."""
    rows = []
    for line in (line for lines in found.values() for line in lines):
        if "reason" in line:
            rows.append([line["title"], line["case"], line["reason"], *[""] * 4])
            continue
        rows.append(
            [
                line["title"],
                line["case"],
                f"`{line['controller']}`",
                metres(line["clearance_m"]),
                millimetres(line["hand_error_m"]),
                f"{line['base_path_m']:.2f} m",
                "yes" if line["contacts"] else "no",
            ]
        )
    head = ["robot", "case", "controller", "smallest distance", "error", "base path", "contact"]
    return grid(head, rows)


def keep_robots(printed: dict[str, Any]) -> list[dict[str, Any]]:
    """The displayed numbers of each case."""
    shown = ("title", "case", "reason", "controller", "clearance_m", "hand_error_m")
    keys = (*shown, "base_path_m", "contacts")
    return [{key: line[key] for key in keys if key in line} for line in printed["rows"]]


def law(name: str, *options: str) -> tuple[str, ...]:
    """Arguments after `python -m` that run a measurement of the control law."""
    return ("benchmarks.law", name, *options, "--json")


def law_table(found: Figures) -> str:
    """A row for each displayed number of the summaries."""
    rows = []
    if summary := found.get("release", {}).get("summary"):
        what = (
            f"{summary['releases']} releases inside the buffer: longest path of the base afterwards"
        )
        speed = number(summary["speed_after_10s_max_mmps"], "mm/s after 10 s")
        rows.append([what, "release", f"{metres(summary['path_max_m'])}, {speed}"])
    if summary := found.get("pulls", {}).get("summary"):
        what = (
            f"{summary['pulls']} hard pulls of up to 100 N: smallest distance between arm and base"
        )
        met = f"overlap in {summary['overlaps']}, contact in {summary['with_contact']}"
        rows.append([what, "pulls", f"{metres(summary['least_distance_m'])}, {met}"])
        what = "these pulls: largest ratio of a joint's speed to its limit"
        rows.append([what, "pulls", number(summary["joint_speed_share_max"], digits=2)])
    if summary := found.get("wander", {}).get("summary"):
        what = f"{summary['runs']} runs: two people with up to 50 N pull the arm to random places"
        met = f"{metres(summary['least_distance_m'])}, contact in {summary['with_contact']}"
        rows.append([f"{what}: smallest distance between arm and base", "wander", met])
    if summary := found.get("continuity", {}).get("summary"):
        what = "largest jump of the base's commanded acceleration, extrapolated to a step of 0"
        jump = number(summary["jump_mps2"], "m/s²", 1)
        jump += f", {number(summary['jump_radps2'], 'rad/s²', 1)}"
        rows.append([f"{what}, {summary['paths']} motions", "continuity", jump])
    if summary := found.get("paths", {}).get("summary"):
        what = f"{summary['paths']} random tracked curves: number with an error above 1 mm"
        ends = f"{summary['ends_off']} of them at the end, contact in {summary['with_contact']}"
        rows.append([what, "paths", f"{summary['leave']}, {ends}"])
    return grid(
        ["quantity", "command", "value"],
        [[what, f"`python -m benchmarks.law {name}`", value] for what, name, value in rows],
    )


STAGES = {
    "update_estimate": "`update_estimate`, from readings to the present state",
    "pinocchio": "pinocchio's dynamics and placements",
    "distances": "coal's distances",
    "algorithm_2": "`algorithm_2`, the law",
    "rest": "all else: Python between these parts, checks, copies of the commands",
}
"""Parts of a control step, as `dbb bench` times them."""


def performance_table(found: Figures) -> str:
    """A row for each displayed time or rate."""
    rows = []
    if step := found.get("step"):
        for key, what in (
            ("step_p50_us", "control step with both pairs in the buffer, median"),
            ("step_p99_us", "that step, 99th percentile"),
            ("step_own_p50_us", "the shortest of three measurements of each such step, median"),
            ("floor_p50_us", "direct calls of the libraries, median"),
            ("guided_p50_us", "`ControlLoop.step`, guided with one pair in the buffer, median"),
            (
                "tracking_p50_us",
                "`ControlLoop.step`, tracking with both pairs in the buffer, median",
            ),
        ):
            if key in step:
                rows.append([what, number(step[key], "µs")])
        for key, what in (
            ("guided_ratio", "guided step, ratio to the direct calls"),
            ("tracking_ratio", "tracking step, ratio to the direct calls"),
        ):
            if key in step:
                rows.append([what, number(step[key])])
        stages = step.get("stages_p50_us", {})
        for key in filter(stages.__contains__, STAGES):
            rows.append([f"part of a step: {STAGES[key]}, median", number(stages[key], "µs")])
        rows.append(["peak memory of that process", number(step["peak_memory_mb"], "MB")])
    for name in ("alone", "websocket", "browser"):
        if loop := found.get(name):
            what = {
                "alone": "no client",
                "websocket": "a client that drags and draws nothing",
            }
            client = what.get(name, "a headless browser that drags and draws in software")
            periods = [number(loop[f"period_{p}_ms"], digits=3) for p in ("p50", "p99", "max")]
            rows.append([f"real-time factor, {client}", number(loop["realtime_factor"])])
            rows.append(
                [
                    "period of its loop: median, 99th percentile, maximum",
                    f"{' / '.join(periods)} ms",
                ]
            )
    if start := found.get("startup"):
        rows.append(["from `dbb serve` to the page's answer", number(start["page_answers_s"], "s")])
        rows.append(
            [
                "from `dbb serve` to the first complete picture",
                number(start["first_picture_s"], "s"),
            ]
        )
    if page := found.get("page"):
        for state, what in (
            ("idle", "nothing moves"),
            ("playing", "a scenario runs"),
            ("dragging", "the end-effector is dragged"),
            ("plots", "its plots are open"),
        ):
            drawn, sent = page[f"{state}_pictures_per_s"], page[f"{state}_kB_per_s"]
            rates = f"{number(drawn)} pictures/s, {number(sent)} kB/s"
            rows.append([f"a page that draws in software, 1280 x 720, {what}", rates])
        both = (page["gizmo_follows_ms"], page["hand_follows_ms"])
        delays = ", ".join(number(value, "ms") or "not measured" for value in both)
        rows.append(
            ["delay from the mouse to the picture of the gizmo, of the end-effector", delays]
        )
    return grid(["quantity", "value"], rows)


def reach_table(found: Figures) -> str:
    """A row per body."""
    rows = []
    for body, row in found.items():
        for title, of in (("counted", row), ("paper", row["paper"]), ("used", row["description"])):
            if of:
                fit = f"{row['r_squared']:.2f}" if title == "counted" else ""
                rows.append(
                    [body, title, *(number(of[key]) for key in ("A_per_m2", "B_m", "C")), fit]
                )
    return grid(["body", "", "A [1/m²]", "B [m]", "C [-]", "R² of the shells' means"], rows)


def keep_reach(printed: dict[str, Any]) -> dict[str, Any]:
    """The displayed numbers of the body of the link that the command selects."""
    (row,) = (each for each in printed["bodies"].values())
    return {key: row[key] for key in ("A_per_m2", "B_m", "C", "paper", "description", "r_squared")}


def study_table(found: Figures) -> str:
    """A row per band of forces, for each study."""
    counts, rows = ("cases", "entered_buffer", "bodies_overlap", "contact"), []
    for name, study in found.items():
        bands = [band for band in study["by_force"] if band["cases"]]
        options = {"pulls": PULLS, "envelope": ENVELOPE}[name]
        limit = f"{options[options.index('--hand-f-max') + 2]} N"
        for band in bands:
            force = f"{band['from_n']:.0f} to {band['to_n']:.0f} N" if band["to_n"] else "more"
            least = metres(band["least_clearance_m"])
            fastest = number(band["hand_speed_max_mps"], "m/s")
            numbers = (f"{band[key]:,}" for key in counts)
            rows.append([limit, force, *numbers, least, fastest])
    columns = (
        "cases",
        "in the buffer",
        "bodies met",
        "contact",
        "smallest distance",
        "largest speed",
    )
    return grid(["limit of the spring", "force before 10 mm", *columns], rows)


def faults_table(found: Figures) -> str:
    """A row per outcome and per fault; a column per study: with and without time stamps."""
    studies = list(found.values())
    rows = [[title, *(f"{study[key]:,}" for study in studies)] for key, title in _OF_FAULTS.items()]
    for name in studies[0]["faults"]:
        counts = [study["faults"][name] for study in studies]
        cells = (f"{each['within_200_ms']:,} of {each['cases']:,}" for each in counts)
        rows.append([f"`{name}` reported by its name within 0.2 s", *cells])
    return grid(["outcome", *(name.replace("_", " ") for name in found)], rows)


def gallery_table(found: Figures) -> str:
    """A row per robot: its content and the results of its checks, or the reason of the refusal."""
    rows = []
    for name, row in found.items():
        checks = row.get("checks", {})
        notes = [f"{check}: {each['outcome']}" for check, each in checks.items()]
        notes = [line for line in notes if not line.endswith(": passed")]
        undetected = checks.get("arm's bodies", {"numbers": {}})["numbers"].get("unseen_share")
        rows.append(
            [
                f"`{name}`",
                row["verdict"],
                number(row["cpu_s"], "s"),
                ", ".join(row.get("pairs", [])),
                "" if undetected is None else number(100 * undetected, "%", 2),
                *(guided_cell(checks.get(each)) for each in ("guiding-lateral", "guiding-front")),
                row.get("refusal", "; ".join(notes)).replace("|", "\\|"),
            ]
        )
    head = [
        "robot",
        "verdict",
        "creation",
        "pairs",
        "undetected",
        "from the side",
        "from the front",
    ]
    return grid([*head, "checks that did not pass"], rows)


def guided_cell(check: Figures | None) -> str:
    """Smallest distance to the base with and without avoidance, and the motion of the base."""
    if check is None or "min_clearance_m" not in (numbers := check["numbers"]):
        return ""
    near, without, moved = (
        metres(numbers[key])
        for key in ("min_clearance_m", "min_clearance_without_m", "base_displacement_m")
    )
    return f"{near}, `none` {without}; base {moved}"


def keep_study(printed: dict[str, Any]) -> dict[str, Any]:
    """The displayed numbers."""
    keys = ("cases", "failed", "failed_rate_bound_95", "entered_buffer_share", "by_force")
    return {key: printed[key] for key in keys}


def keep_faults(printed: dict[str, Any]) -> dict[str, Any]:
    """The displayed numbers."""
    return {key: printed[key] for key in (*_OF_FAULTS, "faults")}


def keep_all(printed: dict[str, Any]) -> dict[str, Any]:
    """All numbers, because they are few."""
    return printed


def keep_law(printed: dict[str, Any]) -> dict[str, Any]:
    """The summary without the rows."""
    return {"summary": printed["summary"]}


def install_table(found: Figures) -> str:
    """A row per stage of `make run` in a fresh clone."""
    clone = found["clone"]
    stages = {
        "install_s": f"installing {clone['download_mb']:.0f} MB from {clone['installer']}'s cache",
        "compile_s": "compiling the kernels",
        "serve_s": "`dbb serve` until the page answers",
        "page_answers_s": "`git clone` to the page's answer",
    }
    rows = [[what, number(clone[key], "s", 2)] for key, what in stages.items()]
    return grid(["`make run` in a fresh clone", "duration"], rows)


def buffer_table(found: Figures) -> str:
    """A row per speed, a column per place and delay."""
    columns: dict[str, dict[float, str]] = {}
    for row in found["rows"]["rows"]:
        title, need = f"{row['place']}, delay {row['delay_s']:g} s", row["needed_d_b_m"]
        columns.setdefault(title, {})[row["v_mps"]] = f"{need:.2f} m" if need else "none"
    speeds = next(iter(columns.values()))
    rows = [[f"{v:.2f} m/s", *(column[v] for column in columns.values())] for v in speeds]
    return grid(["speed", *columns], rows)


def claims_table(found: Figures) -> str:
    """A row per claim of the paper: its text, the measurement, the verdict."""
    columns = ("section", "figure", "paper", "measured")
    rows = [
        [
            *(str(claim[key]).replace("|", "\\|") for key in columns),
            "yes" if claim["holds"] else "**no**",
        ]
        for claim in found["claims"]["claims"]
    ]
    return grid(["§", "figure", "the paper says", "here", "holds"], rows)


def departures_table(found: Figures) -> str:
    """A row per departure: its number with the printed form and with ours."""
    rows = [
        [f"`{key}`", *("" if x is None else f"{x:.2g}".replace("-", "−") for x in both.values())]
        for key, both in found["departures"].items()
    ]
    return grid(["number", "printed", "here"], rows)


def house_table(found: Figures) -> str:
    """A row per measure with its limit."""
    return grid(
        ["measure", "here", "limit"],
        [
            [row["what"], f"{row['value']:,}", "" if row["limit"] is None else f"{row['limit']:,}"]
            for row in found["house"]["measures"]
        ],
    )


def trust_table(found: Figures) -> str:
    """A row for messages, for each kind of file, for each command with faults, and for hostile
    clients.
    """
    sums: dict[str, Counter[str]] = {}
    growth = []
    for printed in found.values():
        if messages := printed.get("messages"):
            what = f"messages of {len(messages['kinds'])} kinds"
            sums.setdefault(what, Counter()).update({key: messages.get(key, 0) for key in _SENT})
            growth.append(f"{messages['memory_growth'] - 1:+.0%}".replace("-", "−"))
        for kind, counts in printed.get("files", {}).items():
            if kind != "findings":
                sums.setdefault(f"files: {kind}", Counter()).update(counts)
        for command, counts in printed.get("tally", {}).items():
            sums.setdefault(f"faults: `{command}`", Counter()).update(counts)
    rows = []
    for what, counts in sums.items():
        shown = next(each for kind, each in _WORDS.items() if what.startswith(kind))
        outcomes = [f"{counts[key]:,} {words}" for key, words in shown.items()]
        if what.startswith("messages"):
            outcomes.append(f"growth of memory in the parts {', '.join(growth)}")
        often = counts["tries"] or sum(counts[key] for key in shown)
        rows.append([what, f"{often:,}", ", ".join(outcomes)])
    if hostile := found.get("hostile"):
        before, after = hostile["memory_before_mb"], hostile["memory_after_mb"]
        outcome = f"longest wait of a viewer {number(hostile['longest_wait_s'], 's', 2)}, memory "
        outcome += f"{before:,.0f} MB before and {after:,.0f} MB after"
        rows.append(["hostile clients", f"{hostile['seconds']:,.0f} s", outcome])
    return grid(["input", "count", "outcome"], rows)


def mutants_table(found: Figures) -> str:
    """A row per kind of change to robots' files, and a row with the sums of all kinds."""
    sums: dict[str, Counter[str]] = {}
    for part in found.values():
        for kind, counts in part.items():
            for row in (kind, "all"):
                sums.setdefault(row, Counter()).update(counts)
    sums["all"] = sums.pop("all")
    rows = [[kind, *(f"{row[key]:,}" for key in _OUTCOMES)] for kind, row in sums.items()]
    return grid(["change", "read correctly", "refused in a line", "faults"], rows)


_OUTCOMES = ("same", "refused", "FAULT")


_SENT = ("taken", "refused", "garbage")
_WORDS = {
    "messages": {each: each for each in _SENT},
    "files": {"right": "read", "line": "refused in a line"},
    "faults": {
        "orphans": "processes left",
        "ports": "ports open",
        "half": "incomplete results",
        "begun": "temporary files left",
        "lost": "lost results",
        "status": "wrong statuses",
    },
}
"""The words of the table, by the names of the counts."""


SETS: dict[str, ResultSet] = {
    "house": ResultSet({"house": ("tools.house", "--json")}, keep_all, house_table),
    "scenarios": ResultSet(
        {
            **{f"{s} {c}": run(s, "--controller", c) for s, c in product(LINES, COMPARED)},
            **{
                f"refrigerator {c}": run("refrigerator", "--controller", c)
                for c in ("none", "hqp", "dbb")
            },
        },
        keep_run,
        scenarios_table,
    ),
    "disturbances": ResultSet(
        {
            f"{scenario} {name}": run(scenario, *options)
            for scenario in ("guiding-lateral", "guiding-front", "tracking")
            for name, options in DISTURBANCES.items()
        },
        keep_run,
        disturbances_table,
    ),
    "claims": ResultSet(
        {"claims": ("app", "reproduce", "--out", "out/results/reproduction", "--json")},
        lambda printed: {"claims": printed["claims"]},
        claims_table,
    ),
    "departures": ResultSet(
        {
            "departures": (
                *("app", "reproduce", "departures", "--out", "out/results/departures"),
                *("--json",),
            )
        },
        lambda printed: printed["figures"]["departures"]["measured"],
        departures_table,
    ),
    "buffer": ResultSet({"rows": law("buffer")}, keep_all, buffer_table),
    "law": ResultSet(
        {
            "release": law("release"),
            "pulls": law("pulls"),
            "wander": law("wander"),
            "continuity": law("continuity"),
            "paths": law("paths", "--jobs", "2"),
        },
        keep_law,
        law_table,
    ),
    "engines": ResultSet(
        {
            f"{robot} {scenario} {plant}": run(scenario, "--robot", robot, "--physics", plant)
            for robot, names in ENGINE_RUNS.items()
            for scenario in names
            for plant in PLANTS
        },
        keep_run,
        engines_table,
    ),
    "plants": ResultSet(
        {"times": ("benchmarks.engines", "--study", "20", "--json")}, keep_all, plants_table
    ),
    "robots": ResultSet(
        {name: ("benchmarks.robots", "--robots", name, "--json") for name in ROBOTS},
        keep_robots,
        robots_table,
    ),
    "gallery": ResultSet(
        {name: ("benchmarks.gallery", "--robots", name, "--quick", "--json") for name in GALLERY},
        lambda printed: next(iter(printed.values())),
        gallery_table,
        default=False,
    ),
    "study": ResultSet(
        {
            "pulls": ("app", "study", *PULLS, "--out", "out/results/study", "--json"),
            "envelope": ("app", "study", *ENVELOPE, "--out", "out/results/envelope", "--json"),
        },
        keep_study,
        study_table,
    ),
    "faults": ResultSet(
        {
            "without_time_stamps": ("app", "study", *FAULTY, "--out", "out/results/f0", "--json"),
            "with_time_stamps": (
                *("app", "study", *FAULTY, "--time-stamps"),
                *("--out", "out/results/f1", "--json"),
            ),
        },
        keep_faults,
        faults_table,
    ),
    "reach": ResultSet(
        {body: ("app", "reach", "--body", body, "--json") for body in ("lEE", "l3")},
        keep_reach,
        reach_table,
    ),
    "install": ResultSet(
        {"clone": ("benchmarks.fresh_clone",)},
        keep_all,
        install_table,
        default=False,
    ),
    "performance": ResultSet(
        {
            "step": ("app", "bench", "--no-border", "--json"),
            "alone": ("benchmarks.realtime", "--client", "none", "--json"),
            "websocket": ("benchmarks.realtime", "--client", "websocket", "--drag", "--json"),
            "browser": ("benchmarks.realtime", "--client", "browser", "--drag", "--json"),
            "startup": ("benchmarks.startup",),
            "page": ("benchmarks.page", "--json"),
        },
        keep_all,
        performance_table,
        default=False,
    ),
    "trust": ResultSet(
        {
            f"{what} {seed}": (*words, "--seed", str(seed), "--json")
            for what, (parts, words) in TRUST.items()
            for seed in range(parts)
        }
        | {"hostile": ("benchmarks.hostile", "--seconds", "600", "--json")},
        keep_all,
        trust_table,
        default=False,
    ),
    "mutants": ResultSet(
        {
            f"from {first}": ("benchmarks.urdf_mutants", "--first", f"{first}", *MUTANTS)
            for first in range(0, 200, 50)
        },
        keep_all,
        mutants_table,
        default=False,
    ),
    "peers": ResultSet(
        {name: ("benchmarks.peers", "--only", name, "--json") for name in PEERS},
        lambda printed: printed["rows"],
        lambda found: peers_table([row for rows in found.values() for row in rows]).strip(),
        default=False,
    ),
}
"""The sets by their names, which files, tables in pages and the command line use."""

assert set(COMPARED) == set(CONTROLLERS)
