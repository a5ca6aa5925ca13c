"""The planner's calls and values that the studies are handed; the studies do not import the planner."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

from replay_kit.core.arrays import Array
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.plan import Place, Plan
from replay_kit.studies.planning.replanning import PlanLegs


class Mission(Protocol):
    """What the studies read of a planned mission; ``planners.MissionPlan`` says what each is."""

    @property
    def status(self) -> str: ...  # noqa: D102
    @property
    def message(self) -> str: ...  # noqa: D102
    @property
    def start(self) -> Place: ...  # noqa: D102
    @property
    def headings_deg(self) -> Array: ...  # noqa: D102
    @property
    def glide_angles_deg(self) -> Array: ...  # noqa: D102
    @property
    def surfacings(self) -> Array: ...  # noqa: D102
    @property
    def closest_approach(self) -> Array: ...  # noqa: D102
    @property
    def duration(self) -> float: ...  # noqa: D102
    @property
    def track(self) -> Array: ...  # noqa: D102


class Flights(Protocol):
    """What the studies read of a mission flown in several currents; ``planners.mission.flights.MissionFlights`` says what each is."""

    @property
    def place(self) -> Array: ...  # noqa: D102
    @property
    def miss(self) -> Array: ...  # noqa: D102


class PlanMission(Protocol):
    """``planners.plan_mission``."""

    def __call__(  # noqa: D102
        self, flow: FlowEstimate, start: Place, goals: Place, *, vehicle: Any, settings: Any, no_go: tuple[Any, ...] = ()
    ) -> Mission: ...


class PlanScenarios(Protocol):
    """``planners.plan_scenarios``."""

    def __call__(  # noqa: D102
        self,
        flow: FlowEstimate,
        samples: Sequence[FlowEstimate],
        start: Place,
        goals: Place,
        *,
        allowed: float,
        vehicle: Any,
        settings: Any,
        no_go: tuple[Any, ...] = (),
    ) -> tuple[Mission, Any]: ...


@dataclass(frozen=True, slots=True)
class Calls:
    """The planner, as the studies see it.

    Attributes:
        plan: One glide: (flow, start, goal).
        fly: A glide's plan in another flow: time, track, closest approach [m].
        plan_mission: A mission.
        fly_mission: A mission in one current or several.
        plan_scenarios: A mission that keeps clear in samples.
        fly_corrected: A mission in some currents, corrected at each surfacing by a pilot who knows the flow: what comes of it.
        glider: Makes a vehicle of a speed [m/s] and of the least and largest glide angle [degrees].
        settings: Makes settings of a mission from their names.
        no_go: Makes an area from its corners, longitude and latitude [degrees], and its name.
        legs_planner: Makes the planner of the study of replanning, for dives to a depth [m].
    """

    plan: Callable[[FlowEstimate, Place, Place], Plan]
    fly: Callable[[FlowEstimate, Plan], tuple[Array, Array, float]]
    plan_mission: PlanMission
    fly_mission: Callable[[FlowEstimate | Sequence[FlowEstimate], Any], Flights]
    plan_scenarios: PlanScenarios
    fly_corrected: Callable[[FlowEstimate, Sequence[FlowEstimate], Any], Any]
    glider: Callable[[float, float, float], Any]
    settings: Callable[..., Any]
    no_go: Callable[[tuple[tuple[float, float], ...], str], Any]
    legs_planner: Callable[[float], PlanLegs]
