"""A result shown: report, status, plots, exports, and the value that a notebook holds. Nothing here is estimated or planned."""

from typing import TYPE_CHECKING

from replay_kit.core.on_demand import on_demand

if TYPE_CHECKING:
    from replay_kit.show.opened import Result, open_result

__all__ = ["Result", "open_result"]

__getattr__ = on_demand(globals(), {"Result": "opened", "open_result": "opened"})
