"""Labels that make the file of a recording explain itself: units, names of axes and of their entries, as HDF5 scales.

Datasets have the attribute `units`. In complete recordings they also have named axes, by the convention of netCDF-4,
which xarray reads. Dimension scales beyond the layout of `nsdyn.recording.columns` are::

    /t_steps                     (n,)   s, ends of the steps
    /coordinate, /velocity       names of the columns of /q and /v
    /joint_coordinate, /link     names of the columns of /joints and /pieces, and of the links of /links
    /body, /shape                names of the moving bodies of /frames, of the shapes of /contacts/geom1 and geom2
    /axis, /quaternion, /side, /wrench, /lift
                                 x y z; x y z w; N T1 T2; force and moment; shift and turn
    /contacts/contact, /pieces/piece, /wrenches/row, /lifts/row
                                 (.,)   s, end of the step of each row

A group has hard links to the scales that its datasets use.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import h5py
import numpy as np

from nsdyn.recording.columns import CONTACT_STATES, LAYOUT, ON_BODIES, rows_of

ROWS = {"states": "t", "steps": "t_steps", "contacts": "contacts/contact", "pieces": "pieces/piece"}
ROWS |= {group: f"{group}/row" for group in ON_BODIES}
"""Names of the axis of rows, by what a column has a row for."""


def name_units(file: Any, meta: Mapping[str, Any], columns: Iterable[str]) -> None:
    """Write the units of the columns of a file, names for the values of the status, and the attributes of `/meta`."""
    file.attrs.update(meta)
    for name in columns:
        file[name].attrs["units"] = LAYOUT[name].unit
    from nsdyn.problem.solution import Status  # not needed to read a recording

    for side in ("geom1", "geom2"):
        file[f"contacts/{side}"].attrs["long_name"] = "number of the shape, in the order of /shape"
    for name, words in (("contacts/status", CONTACT_STATES), ("solver/status", [status.name for status in Status])):
        file[name].attrs.update(flag_values=np.arange(len(words), dtype="i1"), flag_meanings=" ".join(words))


def name_axes(file: Any, scene: Mapping[str, Any], columns: Iterable[str]) -> None:
    """Write the names of the axes of the columns of a complete file, and of the entries along the axes."""
    file["t_steps"] = file["t"][1:]
    file["t_steps"].attrs["units"] = "s"
    axes = {name: _axes(name) for name in columns if name != "t"}
    labels, used = _labels(scene), dict.fromkeys(axis for own in axes.values() for axis in own)
    for axis in used:
        if axis in labels:
            file.create_dataset(axis, data=np.array(labels[axis], dtype=object), dtype=h5py.string_dtype())
        elif "/" in axis:
            rows = np.diff(file[f"{axis.partition('/')[0]}/offset"][:])
            file.create_dataset(axis, data=np.repeat(file["t"][1:], rows), compression="gzip", shuffle=True)
            file[axis].attrs["units"] = "s"
        file[axis].make_scale(axis)
    file.create_dataset("shape", data=np.array(labels["shape"], dtype=object), dtype=h5py.string_dtype())
    file["shape"].make_scale("shape")
    for slot in file.get("state", {}).values():
        for name, item in slot.items():
            item.make_scale(name)
    for name, own in axes.items():
        group = file[name].parent
        for k, axis in enumerate(own):
            file[name].dims[k].attach_scale(file[axis])
            if "/" not in axis and axis not in group:
                group[axis] = file[axis]


def _axes(name: str) -> tuple[str, ...]:
    """Return the names of the scales of a column."""
    return (ROWS[rows_of(name)], *LAYOUT[name].axes)


def _labels(scene: Mapping[str, Any]) -> dict[str, list[str]]:
    """Return the names of the entries along each axis."""
    free = scene["frames"][: scene["free"]]
    coordinates = [f"{name}/{part}" for name in free for part in ("x", "y", "z", "qx", "qy", "qz", "qw")]
    velocities = [f"{name}/{part}_{axis}" for name in free for part in ("v", "omega") for axis in "xyz"]
    joints, links = list[str](), list[str]()
    for a in scene["articulations"]:
        names = [f"{a['name']}/{joint}" for joint in a["joints"]]
        links += names
        for name, (nq, nv) in zip(names, a["sizes"], strict=True):
            coordinates += [name] if nq == 1 else [f"{name}/{k}" for k in range(nq)]
            joints += [name] if nv == 1 else [f"{name}/{k}" for k in range(nv)]
    return {
        "coordinate": coordinates,
        "velocity": velocities + joints,
        "axis": list("xyz"),
        "side": ["N", "T1", "T2"],
        "shape": [geom["name"] for geom in scene["geoms"]],
        "body": scene["frames"],
        "quaternion": list("xyzw"),
        "joint_coordinate": joints,
        "link": links,
        "wrench": [f"{part}_{axis}" for part in ("force", "moment") for axis in "xyz"],
        "lift": [f"{part}_{axis}" for part in ("shift", "turn") for axis in "xyz"],
    }
