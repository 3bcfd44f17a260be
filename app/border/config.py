"""Parameters of the offline sampling of link pairs and clouds P_i."""

from pydantic import Field

from app.strict import Strict


class SamplingConfig(Strict):
    """Parameters of the sampling of joint positions, for the pairs of (1) and for P_i."""

    seed: int = Field(default=0, ge=0)
    """[-] seed of all random numbers."""
    pair_samples: int = Field(default=100_000, ge=100)
    """[-] number of joint positions for (1)."""
    cloud_samples: int = Field(default=200_000, ge=100)
    """[-] number of random joint positions per pair; those in range start the flood of P_i."""
    d_low: float = Field(default=0.03, ge=0.0, le=0.3)
    """[m] smallest distance d_m of P_i."""
    d_high: float = Field(default=0.32, ge=0.05, le=0.6)
    """[m] largest distance d_m of P_i."""
    voxel_plan: float = Field(default=0.008, ge=0.002, le=0.1)
    """[m] horizontal side of a voxel; P_i has at most one point in each voxel."""
    voxel_height: float = Field(default=0.005, ge=0.002, le=0.1)
    """[m] height of a voxel."""
    sectors: int = Field(default=16, ge=1, le=64)
    """[-] number of sectors around the base's centre that are flooded separately."""
    rounds: int = Field(default=4, ge=1, le=16)
    """[-] number of floods of a sector; the second and later floods start at the borders to the
    neighbouring sectors."""
    retries: int = Field(default=6, ge=0, le=16)
    """[-] number of further attempts of a batch of postures to step into open voxels."""


QUICK = SamplingConfig(
    pair_samples=20_000,
    cloud_samples=20_000,
    voxel_plan=0.03,
    voxel_height=0.03,
    rounds=1,
    retries=2,
    sectors=8,
)
"""A coarse sampling, which takes seconds on one core: fewer samples, and voxels of 3 cm."""
