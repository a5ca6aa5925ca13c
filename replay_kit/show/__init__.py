"""A result shown: report, status, plots, exports, and the value that a notebook holds. Nothing here is estimated or planned."""

from typing import TYPE_CHECKING

from replay_kit.core.extensions import on_demand

if TYPE_CHECKING:
    from replay_kit.show.notebook import Result, open_result

__all__ = ["Result", "open_result"]

__getattr__ = on_demand(globals(), {"Result": "notebook", "open_result": "notebook"})
