"""Summary of a world, for people and programs."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from pipelines.lightfield.world_file import World, WorldArea, load_world, recognition_bytes


@dataclass(frozen=True)
class WorldSummary:
    """A world and the folder that holds it.

    Attributes:
        path: the folder.
        world: its index.
        retrieval_bytes: what finds the areas of an image takes in ``world.h5``; 0: there is none.
    """

    path: Path
    world: World
    retrieval_bytes: int

    def table(self) -> list[tuple[str, ...]]:
        """Rows for people: one an area, and the sums."""
        head = ("area", "own", "views", "file", "in memory", "x", "y", "neighbours")
        rows = [head]
        for area in self.to_dict()["areas"]:
            low_x, high_x, low_y, high_y = area["rectangle_m"]
            rows.append(
                (
                    area["name"],
                    str(area["own_views"]),
                    str(area["views"]),
                    f"{area['file_bytes'] / 1e6:.1f} MB",
                    f"{area['memory_bytes'] / 1e6:.1f} MB",
                    f"{low_x:.1f} to {high_x:.1f} m",
                    f"{low_y:.1f} to {high_y:.1f} m",
                    ", ".join(area["neighbours"]) or "none",
                )
            )
        facts = self.to_dict()
        total = (
            "1 area" if len(self.world.areas) == 1 else f"{len(self.world.areas)} areas",
            str(facts["photos"] - facts["left_out"]),
            str(sum(area["views"] for area in facts["areas"])),
            f"{facts['file_bytes'] / 1e6:.1f} MB",
            f"{sum(area['memory_bytes'] for area in facts['areas']) / 1e6:.1f} MB",
        )
        index = ("retrieval index", "", "", f"{self.retrieval_bytes / 1e6:.1f} MB")
        return [*rows, total, index]

    def to_dict(self) -> dict[str, Any]:
        """Plain JSON types."""
        world = self.world
        return {
            "path": str(self.path),
            "kind": "world",
            "identifier": world.identifier,
            "division": dict(world.division),
            "photos": len(world.image_names),
            "left_out": int(np.count_nonzero(world.home < 0)),
            "links": len(world.links),
            "file_bytes": sum(area.file_bytes for area in world.areas),
            "retrieval_bytes": self.retrieval_bytes,
            "areas": [self._area(number, area) for number, area in enumerate(world.areas)],
        }

    def _area(self, number: int, area: WorldArea) -> dict[str, Any]:
        return {
            "name": area.name,
            "own_views": int(np.count_nonzero(self.world.home == number)),
            "views": len(area.views),
            "rectangle_m": area.rectangle.tolist(),
            "bounds_m": area.bounds.tolist(),
            "neighbours": list(area.neighbours),
            "identifier": area.identifier,
            "file_bytes": area.file_bytes,
            "memory_bytes": area.memory_bytes,
        }


def describe_world(path: Path) -> WorldSummary:
    """Reads the index of a world and summarizes it.

    Raises:
        InputError: missing, half built, damaged, of a newer schema, or with an area's file missing
            or of another build.
    """
    return WorldSummary(path, load_world(path), recognition_bytes(path))
