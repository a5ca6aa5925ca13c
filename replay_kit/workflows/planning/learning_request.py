"""What ``plan --objective learn`` and ``map`` are asked for, with the options that exclude each other refused."""

from dataclasses import dataclass
from math import inf
from pathlib import Path
from typing import Literal

from replay_kit.core.errors import ConfigError
from replay_kit.core.plan import Place
from replay_kit.workflows.planning.request import ARRIVING


@dataclass(frozen=True, slots=True)
class LearnJob:
    """A plan that learns, and the files that it is planned on.

    Attributes:
        objective: ``learn`` or ``map``.
        flows: Files of the estimate; one.
        start: Where it begins.
        then: Of a stretch without fixes, in order.
        blind: Duration of that stretch [h]; None without.
        survey: Duration of the survey before it [h]; None for 24.
        box: Whose current is mapped: west, south, east, north, depths; None without.
        profiles: That a map may take; None without.
        error: Standard deviation of the error of a profile's mean current [m/s].
        others: Results with plans of others, whose profiles come anyway.
        no_go: GeoJSON of areas; None for none.
        bathymetry: NetCDF with the depth of the bottom; None for none.
        start_time_ns: When it begins [ns, UTC]; None for the estimate's time.
        arrive: Share of the samples that must meet the goal for the plan to be called ``reached``.
    """

    objective: Literal["learn", "map"]
    flows: tuple[Path, ...]
    start: Place
    then: tuple[Place, ...] = ()
    blind: float | None = None
    survey: float | None = None
    box: tuple[float, ...] | None = None
    profiles: int | None = None
    error: float = 0.03
    others: tuple[Path, ...] = ()
    no_go: Path | None = None
    bathymetry: Path | None = None
    start_time_ns: int | None = None
    arrive: float = ARRIVING

    def check(self) -> None:
        """Refuse options that do not go together.

        Raises:
            ConfigError: One needs another that is not given, or excludes it, or is out of range.
        """
        maps, blind = self.objective == "map", self.blind is not None or bool(self.then)
        refusals = (
            (
                len(self.flows) > 1,
                "--objective learn and map: expected one estimate; how errors of several files relate is not known",
            ),
            (
                not maps and (self.box or self.profiles),
                "--box and --profiles: expected --objective map beside them",
            ),
            (
                maps and (blind or self.survey),
                "--objective map: expected no --then, --blind and --survey",
            ),
            (
                maps and not (self.box and self.profiles),
                "--objective map: expected --box W,S,E,N[,DEPTHS] and --profiles N",
            ),
            (
                not maps and not (self.blind is not None and self.then),
                "--objective learn: expected --then and --blind: where the stretch without fixes leads, and for how many hours",
            ),
        )
        for refused, message in refusals:
            if refused:
                raise ConfigError(message)
        if not 0.0 <= self.arrive <= 1.0:
            raise ConfigError(f"--arrive: expected a share from 0 to 1, got {self.arrive:g}")
        for name, value in (
            ("--blind", self.blind),
            ("--survey", self.survey),
            ("--profile-error", self.error),
            ("--profiles", self.profiles),
        ):
            if value is not None and not 0.0 < value < inf:
                raise ConfigError(f"{name}: expected a number above 0, got {value:g}")
