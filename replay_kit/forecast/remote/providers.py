"""Data sets that clients of their own receive: Copernicus Marine and Icechunk, imported when they are asked for."""

import re
from typing import Any

import xarray as xr

from replay_kit.core.errors import ForecastError
from replay_kit.core.paths import Address


def open_cmems(address: Address, name: str) -> xr.Dataset:
    """Return a data set of Copernicus Marine, by the provider's own client, which keeps the login; times are numbers, as in a file.

    Raises:
        ForecastError: The client is not installed, or refuses.
    """
    try:
        import copernicusmarine
    except ImportError as error:
        raise ForecastError(
            f"{address}: needs the client of Copernicus Marine (EUPL licence): pip install 'replay-kit[cmems]'; then copernicusmarine login"
        ) from error
    try:
        ds: xr.Dataset = copernicusmarine.open_dataset(dataset_id=name)
    except Exception as error:
        raise ForecastError(
            f"{address}: Copernicus Marine's client answers: {_clean(error)}; is the name right, and copernicusmarine login done?"
        ) from error
    ds = ds.drop_encoding()
    dated = {
        name: xr.conventions.encode_cf_variable(variable, name=name)
        for name, variable in ds.variables.items()
        if variable.dtype.kind in "mM"
    }
    return ds.assign(dated)


def icechunk_store(address: Address, url: str) -> Any:
    """Return the Zarr store of the main branch of an Icechunk repository on a server that speaks S3, by Icechunk's own client.

    Raises:
        ForecastError: It is not installed, or there is no such repository.
    """
    try:
        import icechunk
    except ImportError as error:
        raise ForecastError(f"{address}: needs Icechunk: pip install icechunk") from error
    try:
        host, _, path = url.partition("://")[2].partition("/")
        bucket, _, prefix = path.partition("/")
        storage = icechunk.s3_storage(
            bucket=bucket,
            prefix=prefix.rstrip("/"),
            endpoint_url=f"{url.partition('://')[0]}://{host}",
            region="us-east-1",
            allow_http=url.startswith("http:"),
            anonymous=True,
            force_path_style=True,
        )
        return icechunk.Repository.open(storage).readonly_session("main").store
    except Exception as error:
        raise ForecastError(
            f"{address}: cannot be opened as an Icechunk repository: {_clean(error)}"
        ) from error


def _clean(error: Exception) -> str:
    """Return the first line of a foreign error that says something, without addresses, which may hold a login."""
    text = re.sub(r"\S+://\S+", "(an address)", " ".join(str(error).split()))
    return text[:200] or type(error).__name__
