"""Stops: joint limits that prevent collisions of the base with links close to it by design.

No pair monitors these links, which are within d_b of the base in most postures. An example is
the upper arm of a UR: a limit of the shoulder lift joint keeps it away from the base.
"""

from collections.abc import Sequence

import numpy as np

from app.config import parameter
from app.errors import RobotFileError
from app.onboarding.fit.collision_sampling import ALWAYS, MARGIN, Meetings, free_postures
from app.onboarding.fit.units import hull_distances
from app.onboarding.numbers import Limits
from app.onboarding.read.tree import Arm
from app.robot.link_pairs import sample_joints
from app.robot.model import RobotModel
from app.strict import Array

_VALUES = 400  # [-] sampled positions of the limited joint
_POSTURES = 60  # [-] sampled postures of the other joints at each of these positions
LEAST = 0.25  # [-] smallest share of its range, or of a turn, that a limited joint retains
_ALIKE = 0.05  # [-] resolution for comparing the remaining shares of joints' ranges


def with_stops(
    limits: Limits,
    model: RobotModel,
    arm: Arm,
    meetings: Meetings,
    ready: Sequence[float] | None = None,
) -> Limits:
    """Joint limits that, if possible, prevent contact of the base with links close to it by design.

    For each of these links that touches the base in a sampled posture, one joint before the link
    gets narrower limits: the joint that retains the largest share of its range. If no joint retains
    a quarter of its range, or of a turn if this is less, no limit changes; see `watching_buffer`.
    `ready` (n_m,) is a posture that the limits have to include, or None.

    Raises:
        RobotFileError: Limits can prevent the contact, but none of them includes `ready`.
    """
    lower, upper = np.array(limits.lower), np.array(limits.upper)
    stops = {}
    for u, v in sorted(meetings.close & meetings.apart):
        a, b = meetings.units[u], meetings.units[v]
        if not _meet(meetings, (u, v), lower, upper):
            continue
        postures = sample_joints(model, _POSTURES, np.random.default_rng(0)).clip(lower, upper)
        stopping, possible = [], False
        for joint in range(b.joint - 1):  # pinocchio's joint 2 is the first one of the arm
            values = np.linspace(lower[joint], upper[joint], _VALUES)
            tried = np.repeat(postures[:, None], _VALUES, axis=1)
            tried[:, :, joint] = values
            found = hull_distances(model, (a, b), [(0, 1)], tried.reshape(-1, model.n_m))
            nearest = found.reshape(_POSTURES, _VALUES).min(axis=0)
            clear = nearest > contact_margin(nearest)
            span = upper[joint] - lower[joint]
            for first, after in np.flatnonzero(np.diff(np.pad(clear, 1))).reshape(-1, 2):
                low, high = values[first], values[after - 1]
                enough = high - low >= LEAST * min(span, 2 * np.pi)
                possible = possible or enough
                if enough and (ready is None or low <= ready[joint] <= high):
                    share = round((high - low) / span / _ALIKE)
                    stopping.append((share, -abs(low + high), joint, low, high))
        if stopping:
            *_, joint, low, high = max(stopping)
            lower[joint], upper[joint] = np.ceil(100 * low) / 100, np.floor(100 * high) / 100
            name, detects = arm.joints[joint].name, detectable(meetings, (u, v))
            reason = f"{b.name} reaches {a.name}{detects}"
            stops[name] = f"{stops[name]}, and {reason}" if name in stops else reason
        elif possible:
            raise RobotFileError(
                f"--ready: {b.name} can meet {a.name} near this posture; choose another posture"
            )
    return limits._replace(lower=tuple(lower.tolist()), upper=tuple(upper.tolist()), stops=stops)


def contact_margin(distances: Array) -> float:
    """[m] distance up to which two links with `distances` (N,) [m] in postures count as in contact:
    `MARGIN`, or half of the largest of `distances` if that is less, as for adjacent links.
    """
    return float(np.clip(distances.max() / 2, 0.0, MARGIN))


def watching_buffer(limits: Limits, meetings: Meetings, d_b: float) -> tuple[float, str]:
    """A buffer distance [m] with which pairs of bodies detect collisions that no limit prevents.

    It is `d_b` with an empty text, or a smaller multiple of 0.01 m with its reason. Collisions that
    no valid value of `border.d_b` makes detectable are ignored.
    """
    least, why = d_b, ""
    for u, v in sorted(meetings.close & meetings.apart):
        wanted = _monitored_from(meetings, (u, v))
        met = _meet(meetings, (u, v), np.array(limits.lower), np.array(limits.upper))
        if met and 0.0 < wanted < least:
            a, b = (meetings.units[k].name for k in (u, v))
            least, why = wanted, f"{b} is nearer than {d_b:g} m to {a} in most postures"
    return least, why


def _monitored_from(meetings: Meetings, pair: tuple[int, int]) -> float:
    """A d_b [m] with which a pair can monitor two units, or 0 if none is valid.

    The units are outside of the buffer in the share `ALWAYS` of the free postures, although
    1 − `ALWAYS` would be sufficient for the links: their bodies are larger.
    """
    distances = meetings.random.distances
    gaps = distances[free_postures(distances), meetings.pairs.index(pair)]
    wanted = float(np.floor(100 * np.quantile(gaps, 1.0 - ALWAYS)) / 100)
    return wanted if wanted >= parameter("border.d_b").low else 0.0


def detectable(meetings: Meetings, pair: tuple[int, int]) -> str:
    """A text with a d_b with which a pair can detect a contact; empty if no d_b is valid."""
    wanted = _monitored_from(meetings, pair)
    return f", which a pair can detect with --buffer-distance {wanted:g} or less" if wanted else ""


def _meet(meetings: Meetings, pair: tuple[int, int], lower: Array, upper: Array) -> bool:
    """Whether two units touch in at least one sampled posture within joint limits."""
    q_m, gaps = meetings.random.q_m, meetings.random.distances[:, meetings.pairs.index(pair)]
    return bool((gaps[((q_m >= lower) & (q_m <= upper)).all(axis=1)] <= 0.0).any())
