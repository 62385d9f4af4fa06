"""A world that a Dask cluster builds is the same, whatever becomes of a worker."""

import os
import signal
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from pipelines.artifacts.provenance import sha256_of_file
from pipelines.lightfield.stage import ModelSettings
from pipelines.lightfield.world import AreaSettings, model_world
from tests.chain_samples import lfnav
from tests.world_samples import FLOOR, TWO_ROOMS, rooms_reconstruction

FLAT = ModelSettings(plane=(0.0, 0.0, 1.0, 0.0))
distributed: Any = pytest.importorskip("distributed")


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """``map`` and ``areas.toml`` of the two rooms, and the world that this process made of them."""
    folder = tmp_path_factory.mktemp("rooms")
    rooms_reconstruction(folder)
    (folder / "areas.toml").write_text(TWO_ROOMS, encoding="utf-8")
    model_world(folder / "map", folder / "world", AreaSettings(file=folder / "areas.toml"), FLAT)
    return folder


@pytest.fixture(scope="module")
def cluster(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Any]:
    """A scheduler and two workers, each with processes of its own."""
    with distributed.SubprocessCluster(
        n_workers=2,
        threads_per_worker=1,
        dashboard_address="127.0.0.1:0",
        host="127.0.0.1",
        worker_kwargs={"local_directory": str(tmp_path_factory.mktemp("dask"))},
    ) as running:
        running.wait_for_workers(2)
        yield running


def content(folder: Path) -> dict[str, str]:
    return {
        str(path.relative_to(folder)): sha256_of_file(path)
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }


def test_a_cluster_builds_the_same_bytes(place: Path, cluster: Any, tmp_path: Path) -> None:
    options = ("--areas", place / "areas.toml", "--plane", FLOOR)
    address = cluster.scheduler_address
    outcome = lfnav(
        "model", place / "map", "-o", tmp_path / "world", *options, "--scheduler", address
    )
    assert outcome.code == 0, outcome.err
    assert content(tmp_path / "world") == content(place / "world")
    assert list(tmp_path.iterdir()) == [tmp_path / "world"]


def test_a_worker_that_is_killed_costs_its_task_and_not_the_build(
    place: Path, cluster: Any, tmp_path: Path
) -> None:
    settings = AreaSettings(file=place / "areas.toml", scheduler=cluster.scheduler_address)
    killed: list[int] = []

    def kill_a_busy_worker() -> None:
        with distributed.Client(cluster.scheduler_address) as client:
            processes = client.run(os.getpid)
            for _ in range(2000):
                busy = [worker for worker, keys in client.processing().items() if keys]
                if busy:
                    os.kill(processes[busy[0]], signal.SIGKILL)
                    killed.append(processes[busy[0]])
                    return
                time.sleep(0.005)

    killer = threading.Thread(target=kill_a_busy_worker)
    killer.start()
    # The killer is at its post before there is work.
    time.sleep(1.0)
    model_world(place / "map", tmp_path / "world", settings, FLAT)
    killer.join()
    assert killed
    assert content(tmp_path / "world") == content(place / "world")


def test_what_a_worker_cannot_do_is_one_line(place: Path, cluster: Any, tmp_path: Path) -> None:
    options = ("--areas", place / "areas.toml", "--geometry", "depth", "--depth", "given")
    address = cluster.scheduler_address
    outcome = lfnav(
        "model", place / "map", "-o", tmp_path / "world", *options, "--scheduler", address
    )
    assert outcome.code == 1
    assert "depth.txt: is missing" in outcome.err
    assert len(outcome.err.splitlines()) == 1
    assert not (tmp_path / "world").exists()


def test_a_scheduler_that_is_not_there_is_one_line(
    place: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("pipelines.artifacts.cluster.CONNECT_SECONDS", 0.5)
    options = ("--areas", place / "areas.toml", "--plane", FLOOR)
    outcome = lfnav(
        *("model", place / "map", "-o", tmp_path / "world", *options),
        *("--scheduler", "tcp://127.0.0.1:1"),
    )
    assert outcome.code == 1
    assert "no Dask scheduler answers at 'tcp://127.0.0.1:1'" in outcome.err
    assert len(outcome.err.splitlines()) == 1
    assert not (tmp_path / "world").exists()
