"""The estimation methods that the studies compare, by name."""

from typing import Any

import numpy as np

from replay_kit.config.gating import GatingConfig
from replay_kit.config.run import EstimatorConfig
from replay_kit.core.grid import Ensemble, Grid
from replay_kit.estimator import Estimator, build_estimator
from replay_kit.estimator.baselines import BASELINES, build_baseline
from replay_kit.estimator.basis.modes import LENGTH_IN_CELLS
from replay_kit.estimator.basis.slices import cell_size

# ``paper_cells`` is the paper's estimator with its length in cells rather than in kilometres, for grids coarser than its own.
METHODS = (
    "default",
    "paper",
    "paper_cells",
    *(name for name in BASELINES if name != "depth_average"),
)


def build_method(name: str, ensemble: Ensemble, config: EstimatorConfig) -> Estimator[Any]:
    """Return the estimator that a method's name stands for.

    Raises:
        ConfigError: The name is unknown.
    """
    if name not in ("default", "paper", "paper_cells"):
        return build_baseline(name, ensemble, config)
    return build_estimator(
        ensemble,
        preset_config(name, ensemble.grid, config),
        GatingConfig() if name == "default" else None,
    )


def preset_config(name: str, grid: Grid, config: EstimatorConfig) -> EstimatorConfig:
    """Return the settings of ``default``, ``paper`` or ``paper_cells``: its preset, and its length on a grid."""
    length = LENGTH_IN_CELLS * float(np.sqrt(np.prod(cell_size(grid))))
    cells = {"length_horizontal": length} if name == "paper_cells" else {}
    return config.model_copy(
        update={"preset": "default" if name == "default" else "paper", **cells}
    )
