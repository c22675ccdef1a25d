"""Filter masks of Nav2 from a map of the probability of connection P.

``keepout`` is occupied where P is below a limit, ``weighted`` is 100 (1 - P), at most `HEAVIEST`
because 100 would be an obstacle, and ``contact`` is 100 where P reaches p_min.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planopt.arrays import Floats
from planopt.errors import InputError
from planopt.files.writing import replaced_results, write_text, write_whole
from planopt.world.raster import Raster

MASKS = ("keepout", "weighted", "contact")
PARAMETERS, LAUNCH = "nav2_filters.yaml", "nav2_filters.launch.py"
NAV2_FILES = (
    *(f"{name}.{ending}" for name in MASKS for ending in ("pgm", "yaml")),
    PARAMETERS,
    LAUNCH,
)
"""Names of all files that belong to the masks."""
FREE, OCCUPIED = 254, 0  # Grey values of free and of occupied cells
HEAVIEST = 99  # Largest value of the mask ``weighted``
KEEPOUT, BINARY = 0, 3  # Filter types in CostmapFilterInfo messages
UNEQUAL_SIDES = 1e-6  # Relative difference of the sides of a cell above which it is not square


@dataclass(frozen=True)
class MaskLimits:
    """Limits of the probability of connection for masks."""

    keepout_below: float = 0.1  # Cells with a smaller probability are forbidden
    contact_from: float = 0.9  # Minimum probability of predicted contact

    def __post_init__(self) -> None:
        for key, value in vars(self).items():
            if not 0.0 <= value <= 1.0:
                name = {"contact_from": "p_min"}.get(key, key)
                raise InputError(f"is {value!r}", key=name, remedy="give a probability, 0 to 1")


def mask_values(probability: Floats, limits: MaskLimits) -> dict[str, NDArray[Any]]:
    """Return the values (ny, nx), from 0 to 100, of each mask as Nav2 reads them."""
    weight = np.clip(np.rint(100.0 * (1.0 - probability)), 0, HEAVIEST).astype(np.int8)
    keepout = np.where(probability < limits.keepout_below, 100, 0).astype(np.int8)
    contact = np.where(probability >= limits.contact_from, 100, 0).astype(np.int8)
    return dict(zip(MASKS, (keepout, weight, contact), strict=True))


def write_masks(folder: Path, probability: Raster, limits: MaskLimits) -> None:
    """Write the masks and the parameters of their filters into a folder."""
    width, height = probability.cell_m
    if abs(width - height) > UNEQUAL_SIDES * width:
        raise InputError(
            f"cells of {width:g} by {height:g} m are not square",
            key="cell_m",
            remedy="Nav2 reads square cells; choose bounds that are multiples of the cell's side",
        )
    if not np.isfinite(probability.values).all():
        raise InputError(
            "has cells without a probability", key="probability", remedy="give 0 to 1 everywhere"
        )
    origin = [float(axis[0] - width / 2.0) for axis in (probability.x_m, probability.y_m)]
    with replaced_results(folder, NAV2_FILES) as new:
        for name, values in mask_values(probability.values, limits).items():
            scaled = name == "weighted"  # A scaled mask uses the whole range of grey values
            grey = np.rint(255.0 - 2.55 * values) if scaled else np.where(values, OCCUPIED, FREE)
            # The first row of a PGM image has the largest y.
            image = b"P5\n%d %d\n255\n" % values.shape[::-1] + grey[::-1].astype(np.uint8).tobytes()
            write_whole(new / f"{name}.pgm", partial(Path.write_bytes, data=image))
            table = {
                "image": f"{name}.pgm",
                "mode": "scale" if scaled else "trinary",
                "resolution": float(width),
                "origin": [*origin, 0.0],
                "negate": 0,
                "occupied_thresh": 1.0 if scaled else 0.65,
                "free_thresh": 0.0 if scaled else 0.25,
            }
            write_text(new / f"{name}.yaml", _yaml(table))
        write_text(new / PARAMETERS, _yaml(_parameters()))
        write_text(new / LAUNCH, LAUNCH_TEXT)


def _parameters() -> dict[str, Any]:
    """Return the parameters of the mask servers, their filter infos and the costmap."""
    tables: dict[str, Any] = {}
    for name in MASKS:
        tables[f"{name}_mask_server"] = _node(
            yaml_filename=f"{name}.yaml", topic_name=f"/{name}_mask", frame_id="map"
        )
        # filter value = base + multiplier * mask value
        tables[f"{name}_filter_info_server"] = _node(
            type=BINARY if name == "contact" else KEEPOUT,
            filter_info_topic=f"/{name}_filter_info",
            mask_topic=f"/{name}_mask",
            base=0.0,
            multiplier=1.0,
        )
    tables["global_costmap"] = {
        "global_costmap": _node(
            filters=[f"{name}_filter" for name in MASKS],
            keepout_filter=_filter("KeepoutFilter", "keepout"),
            weighted_filter=_filter("KeepoutFilter", "weighted"),
            contact_filter=_filter("BinaryFilter", "contact")
            | {
                "default_state": False,
                "binary_state_topic": "/contact_predicted",
                "flip_threshold": 50.0,
            },
        )
    }
    return tables


def _node(**parameters: Any) -> dict[str, Any]:
    return {"ros__parameters": parameters}


def _filter(plugin: str, name: str) -> dict[str, Any]:
    return {
        "plugin": f"nav2_costmap_2d::{plugin}",
        "enabled": True,
        "filter_info_topic": f"/{name}_filter_info",
    }


def _yaml(table: Mapping[str, Any]) -> str:
    import yaml

    return yaml.safe_dump(dict(table), sort_keys=False, default_flow_style=None)


LAUNCH_TEXT = '''"""Start the servers of the radio masks and their filter infos; made by planopt."""

import os

from launch import LaunchDescription
from launch_ros.actions import Node

FOLDER = os.path.dirname(os.path.abspath(__file__))
PARAMETERS = os.path.join(FOLDER, "nav2_filters.yaml")
MASKS = ("keepout", "weighted", "contact")


def generate_launch_description():
    """Describe two lifecycle nodes for each mask, and their manager."""
    nodes, names = [], []
    for mask in MASKS:
        mask_file = {"yaml_filename": os.path.join(FOLDER, mask + ".yaml")}
        for executable, name, more in (
            ("map_server", mask + "_mask_server", [mask_file]),
            ("costmap_filter_info_server", mask + "_filter_info_server", []),
        ):
            names.append(name)
            nodes.append(
                Node(
                    package="nav2_map_server",
                    executable=executable,
                    name=name,
                    output="screen",
                    parameters=[PARAMETERS, *more],
                )
            )
    manager = Node(
        package="nav2_lifecycle_manager",
        executable="lifecycle_manager",
        name="lifecycle_manager_radio_masks",
        output="screen",
        parameters=[{"autostart": True, "node_names": names}],
    )
    return LaunchDescription([*nodes, manager])
'''
