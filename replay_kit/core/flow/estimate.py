"""The current estimate: what a planner or an analyst holds."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from numpy.typing import ArrayLike

from replay_kit.core.flow.field import FlowField

if TYPE_CHECKING:
    import xarray as xr


@dataclass(frozen=True, eq=False)
class FlowEstimate(FlowField):
    """A horizontally divergence-free flow in a box, with its uncertainty when known, that can be exported and saved.

    Attributes and evaluation are those of ``FlowField``. xarray is imported on export only, as most of a run does without it.
    """

    def to_xarray(
        self, longitude: ArrayLike | None = None, latitude: ArrayLike | None = None, depth: ArrayLike | None = None
    ) -> "xr.Dataset":
        """Return velocity and standard error on a grid as a CF dataset; see ``replay_kit.core.flow.netcdf.to_dataset``."""
        from replay_kit.core.flow.netcdf import to_dataset

        return to_dataset(self, longitude, latitude, depth)

    def save(self, path: str | Path) -> None:
        """Write the flow to NetCDF without loss; ``replay_kit.core.flow.load.load`` reads it back."""
        from replay_kit.core.flow.lossless import save

        save(self, Path(path))
