"""A Dask cluster that does the work.

Its workers need lfnav, and the same files under the same paths. The extra ``lfnav[cluster]``
brings Dask, which is imported when a cluster is asked for.
"""

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from pipelines.artifacts.errors import OptionError, quoted

if TYPE_CHECKING:
    from distributed import Client

CONNECT_SECONDS = 15

_log = logging.getLogger(__name__)


@contextmanager
def dask_needed() -> Iterator[None]:
    """For a block that imports Dask, or a module that does.

    Raises:
        OptionError: Dask is not installed.
    """
    try:
        yield
    except ImportError as error:
        raise OptionError(
            f"--scheduler needs Dask ({error}); pip install 'lfnav[cluster]' brings it"
        ) from error


@contextmanager
def cluster_at(address: str) -> Iterator["Client"]:
    """A connection to a cluster, for the duration of a block.

    Args:
        address: of the Dask scheduler, for example ``tcp://host:8786``.

    Raises:
        OptionError: Dask is not installed, or no scheduler answers at the address.
    """
    with dask_needed():
        from distributed import Client
    try:
        client = Client(address, timeout=CONNECT_SECONDS)
    except (OSError, ValueError) as error:
        raise OptionError(f"no Dask scheduler answers at {quoted(address)} ({error})") from error
    with client:
        if not client.scheduler_info()["workers"]:
            _log.warning("the cluster at %s has no workers yet; waiting for them", quoted(address))
        yield client
