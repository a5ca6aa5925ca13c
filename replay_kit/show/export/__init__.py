"""A result as files of other programs: NetCDF, CSV, KML and GeoJSON."""

from replay_kit.show.export.export import ENDINGS, TABLES, export

__all__ = ["ENDINGS", "TABLES", "export"]
