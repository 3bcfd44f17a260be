"""How the poses of a reachability map are sampled."""

from __future__ import annotations

from pydantic import Field

from app.strict import Strict


class ReachConfig(Strict):
    """Uniform poses: positions on a lattice around the arm's mount, random orientations at each."""

    seed: int = Field(default=0, ge=0)
    """[-] of the orientations, the free joints and the restarts."""
    spacing_m: float = Field(default=0.05, ge=0.02, le=0.5)
    """[m] between neighbours of the lattice, for an arm with an analytic solver."""
    orientations: int = Field(default=24, ge=1, le=1000)
    """[-] poses at each position, for an arm with an analytic solver."""
    restart_spacing_m: float = Field(default=0.12, ge=0.02, le=0.5)
    """[m] the same spacing for an arm that is solved by restarts, which takes far longer."""
    restart_orientations: int = Field(default=2, ge=1, le=1000)
    """[-] poses at each position for such an arm."""
    restarts: int = Field(default=24, ge=1, le=1000)
    """[-] restarts in a row that find nothing new before a pose counts as done."""
