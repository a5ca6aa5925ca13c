"""A vehicle's own density along its way: the geostrophic shear of the current across a line of profiles."""

from replay_kit.measurements.section.hydrography import Section, section_of
from replay_kit.measurements.section.thermal_wind import GeostrophicShear, geostrophic_shear

__all__ = ["GeostrophicShear", "Section", "geostrophic_shear", "section_of"]
