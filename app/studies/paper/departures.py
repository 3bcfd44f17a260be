"""The project's departures from equations (26) to (29), and the effect of each departure."""

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pinocchio as pin

from app.config import TaskConfig
from app.control import hqp
from app.control.controller import Controller
from app.control.quantities import ControlStep
from app.control.tasks import Reference, insert_rows
from app.robot.state import at_rest
from app.strict import Array
from app.studies import style
from app.studies.paper import drawing
from app.studies.paper.experiments import AS_PRINTED, LATERAL, PAST_BASE, TRACKING, Sources

_STATES = 40  # [-] number of postures of the lateral guiding
_LINE, _HALVINGS = 100, 20  # [-] number of postures on a line, and of halvings of a step


@style.picture(
    "departures", "(26) to (29) as printed and here", *AS_PRINTED, LATERAL, PAST_BASE, TRACKING
)
def figure_departures(sources: Sources) -> drawing.Drawing:
    """A number for each departure from (26) to (29): for the printed form, and for the form here.

    The printed form is a hierarchy of strict levels (26); it inserts all rows by (29) with the same
    reference q̈_2*. According to the paper, its control input is continuous.
    """
    rows = list(_of_states(sources))
    for place, key, *pair in (
        ("(29) base as commanded", "ee_error_max_m", AS_PRINTED[0], TRACKING),
        ("(29) the base's rows fix its motion", "ee_error_final_m", AS_PRINTED[1], PAST_BASE),
    ):
        rows.append((place, key, *(sources.runs[run].figures[key] for run in pair)))
    table = drawing.table_of(("departure", "number", "printed", "here"), rows)
    figure, ax = style.new_panels(4.2)
    places = np.arange(len(rows))[::-1]
    for column, name, above in (("printed", "hqp", 0.2), ("here", "dbb", -0.2)):
        values = np.maximum(table[column].astype(float), 1e-9)  # the axis is logarithmic
        colour, label = style.METHOD_COLOURS[name], style.METHOD_NAMES[name]
        ax.barh(places + above, values, 0.36, color=colour, label=label)
    ax.set(xscale="log", yticks=places, yticklabels=[f"{place}\n{key}" for place, key, *_ in rows])
    ax.legend(loc="lower right")
    measured = {key: {"printed": printed, "here": here} for _, key, printed, here in rows}
    remark = "Smaller numbers are better. `docs/departures.md` has the reason for each departure."
    return drawing.Drawing(figure, {"": table}, measured, [remark])


def step_at_rest(controller: Controller, q_m: Array, error: float = 0.0) -> ControlStep:
    """The first control step at rest at a posture (n_m,), for a resting reference `error` [m] above
    the end-effector's pose; the next step overwrites the result.
    """
    measured = at_rest(controller.state.model, q_m)
    controller.state.update(measured)
    T = controller.state.T_world_ee.copy()
    T.translation[2] += error
    controller.reset()
    return controller.step(measured, Reference(pin.SE3(T), np.zeros(6), np.zeros(6)))


def printed(w: ControlStep, B: Array, gains: TaskConfig) -> Array:
    """Set `w.B` to B (k,); return q̈ (n,) of `hqp`, NaN if a Jacobian is not finite."""
    w.B[:] = B
    return hqp.solved_by_hierarchy(w, gains)


def here(w: ControlStep, B: Array, gains: TaskConfig) -> Array:
    """q̈ (n,) of the project's form: the base's own rows with the activations B (k,) determine the
    base's part of q̈; then the arm's QP without limits determines the arm's part.
    """
    n_b = w.n_b
    H, c = insert_rows(w.H, w.c, w.J_sca[n_b:], w.b_sca[n_b:], B[n_b:], gains.slack_weight, n_b)
    qdd_b = np.linalg.solve(w.J_sca[:n_b, :n_b], B[:n_b] * w.b_sca[:n_b])
    qdd_a = np.linalg.solve(H[n_b:, n_b:], -(c[n_b:] + H[n_b:, :n_b] @ qdd_b))
    return np.concatenate([qdd_b, qdd_a])


def activations(w: ControlStep, base: float, link: float, pair: int) -> Array:
    """The diagonal of B (k,): `base` in the base's rows, `link` in row `pair` of L_m^c, else 0."""
    B = np.zeros(len(w.B))
    B[: w.n_b], B[w.n_b + pair] = base, link
    return B


def _of_states(sources: Sources) -> Iterator[tuple[Any, ...]]:
    """Departure, key, and the number in the printed form and here, from single control steps."""
    gains = sources.config.task
    controller = Controller(sources.model, sources.data, sources.config, name="hqp")
    enters, left = [], []
    for q_m in postures(sources):
        w = step_at_rest(controller, q_m)
        pair = int(np.argmin(w.d[w.n_mob : len(w.pairs)]))  # the nearest pair of L_m^c
        absent, entered = (activations(w, 0.5, beta, pair) for beta in (0.0, 1e-9))
        changes = [solve(w, entered, gains) - solve(w, absent, gains) for solve in (printed, here)]
        enters.append([float(np.abs(w.M[w.n_b :] @ change).max()) for change in changes])  # [N m]
        w, n_b = step_at_rest(controller, q_m, 0.001), w.n_b
        inserted = here(w, np.zeros(len(w.B)), gains)[n_b:]
        change = inserted - np.linalg.solve(w.H[n_b:, n_b:], -w.c[n_b:])
        below, J = hqp.tasks_below(w, gains), w.J_sca[:n_b]
        qdd_2 = hqp.cascade(below)  # (26); next, (29) as printed, for the base's rows with B = 0
        literal = hqp.cascade([hqp.Task(J, -J @ qdd_2), *below])
        left.append([float(np.linalg.norm(each)) for each in (literal - qdd_2, change)])
    w = step_at_rest(controller, postures(sources)[0], 1.0)
    demands = [float(np.linalg.norm(b)) for b in (hqp.end_effector(w, gains).b, w.b_ee)]
    jumps = [jump(sources, controller, solve) for solve in (printed, here)]
    yield "(26) strict levels", "jump_radps2", *jumps
    yield "(26) k_p (x_d ⊖ x) at 1 m", "demand_mps2", *demands
    yield "(29) reference on the left", "off_at_zero_radps2", *np.max(left, axis=0).tolist()
    yield "(29) a row enters", "torque_jump_nm", *np.max(enters, axis=0).tolist()


def postures(sources: Sources) -> list[Array]:
    """Postures (n_m,) of the lateral guiding at equal intervals, with lm-lEE inside its buffer."""
    inside = np.flatnonzero(sources.distances(LATERAL) < sources.config.border.d_b)
    chosen = inside[np.linspace(0, len(inside) - 1, _STATES).astype(int)]
    return list(sources.runs[LATERAL].trace.of("q_m")[chosen])


def jump(sources: Sources, controller: Controller, solve: Callable[..., Array]) -> float:
    """[rad/s²] norm of the jump of q̈ at the steepest point on a line of postures.

    The base's rows and the row of one pair within the arm are fully active, although this pair is
    outside its buffer: with T_2 there are as many rows as degrees of freedom. The interval with the
    largest change of q̈ is replaced repeatedly by its half with the larger change: a jump remains.
    """
    gains, (first, *_, last) = sources.config.task, postures(sources)
    last = last + 0.5 * (sources.model.q_limits.mean(axis=0) - first)
    w = step_at_rest(controller, first)
    pair = int(np.argmin(w.d[w.n_mob : len(w.pairs)]))  # the nearest pair of L_m^c

    def at(share: float) -> Array:
        w = step_at_rest(controller, first + share * (last - first))
        return solve(w, activations(w, 1.0, 1.0, pair), gains)

    shares = np.linspace(0.0, 1.0, _LINE)
    found = [at(share) for share in shares]
    k = int(np.linalg.norm(np.diff(found, axis=0), axis=1).argmax())
    (a, b), (qdd_a, qdd_b) = shares[k : k + 2], found[k : k + 2]
    for _ in range(_HALVINGS):
        middle = 0.5 * (a + b)
        qdd = at(middle)
        if np.linalg.norm(qdd - qdd_a) > np.linalg.norm(qdd_b - qdd):
            b, qdd_b = middle, qdd
        else:
            a, qdd_a = middle, qdd
    return float(np.linalg.norm(qdd_b - qdd_a))
