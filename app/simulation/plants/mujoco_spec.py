"""A specification of MuJoCo in which only what is named touches, and inertias are what they are."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import product
from typing import Any

import mujoco
import numpy as np
import pinocchio as pin

Array = np.ndarray

GRAVITY = 9.81  # [m/s²]
FLOOR = "floor"
"""Name of the floor's geom, the plane z = 0."""
FIRM = (0.004, 1.0)
"""[s] time constant and [-] damping ratio of contacts and of joint limits."""
IMPEDANCE = [0.95, 0.99, 0.001, 0.5, 2.0]
"""Of both, as MuJoCo has it."""

_STIFFEST = 0.9999  # [-] MuJoCo's greatest impedance
_FRICTION = 0.25  # [-] of two links
_ROUND = 100.0  # [-] firmness of friction over that of contacts


class Spec:
    """A specification.

    Attributes:
        spec: MuJoCo's.
        pairs: The field of `Contacts` that reports two geoms, or None, by their names.
        motors: Names of the joints that have a motor.
    """

    def __init__(self, dt: float) -> None:
        """A floor.

        Args:
            dt: [s] one step.
        """
        self._dt = dt
        self.spec = spec = mujoco.MjSpec()
        self.pairs: dict[frozenset[str], str | None] = {}
        self.motors: list[str] = []
        self._inertias: dict[str, tuple[float, Array]] = {}
        spec.compiler.degree = False
        spec.compiler.inertiafromgeom = mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_FALSE
        option = spec.option
        option.timestep, option.gravity = dt, [0.0, 0.0, -GRAVITY]
        option.integrator = mujoco.mjtIntegrator.mjINT_EULER  # semi-implicit, as pybullet's
        option.cone, option.impratio = mujoco.mjtCone.mjCONE_ELLIPTIC, _ROUND
        option.tolerance = 1e-10
        # Islands copy what `MujocoWorld.step` writes before it can.
        option.disableflags = (
            mujoco.mjtDisableBit.mjDSBL_ISLAND | mujoco.mjtDisableBit.mjDSBL_AUTORESET
        )
        self.add_geom(spec.worldbody, FLOOR, mujoco.mjtGeom.mjGEOM_PLANE, (0, 0, 1))

    def add_body(self, parent: Any, name: str, T: pin.SE3, inertia: pin.Inertia) -> Any:
        """A body of the specification at a pose in its parent.

        Its inertia is written into the compiled model: MuJoCo's compiler refuses what other
        libraries take, such as a link without mass whose joint moves others that have some.
        """
        moments, axes = np.linalg.eigh(inertia.inertia)
        axes[:, 2] = np.cross(axes[:, 0], axes[:, 1])
        self._inertias[name] = inertia.mass, moments
        return parent.add_body(
            name=name,
            **_pose(T),
            mass=1.0,
            inertia=[1.0, 1.0, 1.0],
            explicitinertial=True,
            ipos=inertia.lever,
            iquat=_quaternion(axes),
        )

    def add_geom(
        self,
        body: Any,
        name: str,
        kind: mujoco.mjtGeom,
        size: Sequence[float] | Array = (),
        T: pin.SE3 | None = None,
        mesh: str = "",
    ) -> None:
        """A shape at a pose in its body, that touches nothing but what `allow` names."""
        body.add_geom(
            name=name,
            type=kind,
            size=[*size, 0, 0, 0][:3],
            **_pose(T or pin.SE3.Identity()),
            meshname=mesh,
            contype=0,
            conaffinity=0,
        )

    def add_motor(
        self, body: Any, name: str, kind: mujoco.mjtJoint, axis: Sequence[float], most: float
    ) -> None:
        """A joint whose motor holds it to a velocity, with at most some force or torque.

        That is dry friction against something that moves, which MuJoCo's solver takes together
        with contacts and limits.

        Args:
            body: What it moves.
            name: Its name.
            kind: Its type.
            axis: (3,) its axis.
            most: [N or N m] of the motor.
        """
        body.add_joint(name=name, type=kind, axis=list(axis), **self.friction(most))
        self.motors.append(name)

    def friction(self, most: float) -> dict[str, Any]:
        """A joint's dry friction [N or N m], which ends all motion that it can within a step."""
        return {
            "frictionloss": most,
            "solref_friction": [-1.0, -_STIFFEST / self._dt],
            "solimp_friction": [_STIFFEST, _STIFFEST, 0.001, 0.5, 2.0],
        }

    def allow(
        self,
        group: str | None,
        some: Iterable[str],
        others: Iterable[str],
        *,
        friction: float = _FRICTION,
        firmness: Sequence[float] = FIRM,
        **contact: Any,
    ) -> None:
        """Let each geom of some touch each of others.

        Args:
            group: The field of `Contacts` that reports it; None for none.
            some: Names of geoms.
            others: Names of geoms.
            friction: [-] of the two.
            firmness: [s] time constant and [-] damping ratio of their contact.
            contact: What else MuJoCo takes for it.
        """
        contact = {"solref": list(firmness), "solimp": IMPEDANCE} | contact
        for a, b in product(some, others):
            self.pairs[frozenset((a, b))] = group
            self.spec.add_pair(
                geomname1=a,
                geomname2=b,
                condim=3 if friction else 1,
                friction=[friction, friction, 0.0, 0.0, 0.0],
                **contact,
            )

    def compile(self) -> mujoco.MjModel:
        """The model, with the inertias as they are."""
        compiled = self.spec.compile()
        for name, (mass, moments) in self._inertias.items():
            body = compiled.body(name).id
            compiled.body_mass[body] = mass
            compiled.body_inertia[body] = moments
        mujoco.mj_setConst(compiled, mujoco.MjData(compiled))
        return compiled


def _pose(T: pin.SE3) -> dict[str, Any]:
    return {"pos": T.translation, "quat": _quaternion(T.rotation)}


def _quaternion(R: Array) -> Array:
    """(4,) as MuJoCo has it, w first."""
    x, y, z, w = pin.Quaternion(np.ascontiguousarray(R)).coeffs()
    return np.array([w, x, y, z])
