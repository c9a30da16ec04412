"""Recordings explain themselves to programs that do not know them: units, names of axes, parameters, versions."""

import json

import h5py
import numpy as np
import pytest

import nsdyn as nd
from nsdyn import cli
from nsdyn.recording import file
from nsdyn.recording.columns import LAYOUT, ON_LINKS

NOT_LABELS = "shape coordinate velocity joint_coordinate body axis quaternion side link wrench lift".split()


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    """A box and an arm, recorded by the command line."""
    path = tmp_path_factory.mktemp("labels") / "run.h5"
    assert cli.main(["run", "arm_pushes_box", "--set", "mu=0.3", "--time", "0.1", "-o", str(path)]) == 0
    return path


def test_every_dataset_has_a_unit_and_named_axes(recorded):
    found = {}
    with h5py.File(recorded, "r") as hdf5:
        hdf5.visititems(lambda name, item: found.update({name: item}) if isinstance(item, h5py.Dataset) else None)
        checked = 0
        for name, item in found.items():
            if name.startswith(("state/", "meta/")) or name.rpartition("/")[2] in NOT_LABELS:
                continue
            assert item.attrs["units"], name
            if h5py.h5ds.is_scale(item.id):
                continue
            for axis in item.dims:
                assert len(axis) == 1, name
                assert len(axis[0]) == item.shape[list(item.dims).index(axis)]
            checked += 1
        assert checked > 50
        assert hdf5["contacts/work_friction"].attrs["units"] == "J" and hdf5["contacts/u"].attrs["units"] == "m/s"
        assert hdf5["energy/kinetic"].attrs["units"] == "J" and hdf5["contacts/mu"].attrs["units"] == "1"
        assert hdf5["contacts/status"].attrs["flag_meanings"] == "open stick slip jam"
        assert json.loads(hdf5.attrs["parameters"])["mu"] == 0.3 and "--set mu=0.3" in hdf5.attrs["command"]
        assert {"nsdyn_version", "pin_version", "dt", "solver", "scene_name"} < set(hdf5.attrs)


@pytest.mark.slow
def test_xarray_shows_names_and_units(recorded):
    xarray = pytest.importorskip("xarray")
    pytest.importorskip("h5netcdf")
    run = nd.Trajectory.load(recorded)
    with xarray.open_dataset(recorded, engine="h5netcdf") as states:
        assert states.q.dims == ("t", "coordinate") and states.t.attrs["units"] == "s"
        np.testing.assert_array_equal(states.v.sel(velocity="box/v_x"), run.v[:, 0])
        np.testing.assert_array_equal(states.q.sel(coordinate="arm/elbow"), run.joint("arm/elbow").position)
        assert json.loads(states.attrs["parameters"])["mu"] == 0.3
        assert list(states.q.to_pandas().columns[:3]) == ["box/x", "box/y", "box/z"]
    with xarray.open_dataset(recorded, engine="h5netcdf", group="energy") as energy:
        np.testing.assert_array_equal(energy.friction.t_steps, run.t_steps)
        assert energy.friction.to_series().index.name == "t_steps"
    with xarray.open_dataset(recorded, engine="h5netcdf", group="contacts") as contacts:
        assert contacts.impulse.dims == ("contact", "side") and contacts.point.dims == ("contact", "axis")
        np.testing.assert_array_equal(contacts.impulse.sel(side="N"), run.columns["contacts/impulse"][:, 0])
        last = contacts.impulse.sel(contact=run.t[-1], side="N")  # those of the last step
        np.testing.assert_array_equal(last, run.contacts(-1).impulse_raw[:, 0])
    with xarray.open_dataset(recorded, engine="h5netcdf", group="frames") as frames:
        hand = frames.x.sel(body="arm/elbow", axis="z")
        np.testing.assert_array_equal(hand, run.body("arm/elbow").position[:, 2])
    with xarray.open_datatree(recorded, engine="h5netcdf") as tree:
        assert tree["joints/actuation"].dims == ("t_steps", "joint_coordinate")


@pytest.mark.parametrize("contacts", [True, False])
def test_labels_of_little(contacts, tmp_path):
    """A recording without contacts, and one that is being written, which has units."""
    scene = nd.Scene()
    scene.add_sphere("ball", 0.1, 1.0)
    run = nd.simulate(scene, 0.02, dt=0.01, contacts=contacts)
    run.save(tmp_path / "run.h5")
    assert nd.Trajectory.load(tmp_path / "run.h5").t.tolist() == run.t.tolist()
    begin = file.until(run.columns, 1)
    file.create(tmp_path / "growing.h5", (run.meta, run.scene, begin), grow=True)
    with h5py.File(tmp_path / "growing.h5", "r") as growing:
        assert growing["t"].attrs["units"] == "s" and "t_steps" not in growing
    file.extend(tmp_path / "growing.h5", {name: rows[len(begin[name]) :] for name, rows in run.columns.items()})
    assert nd.Trajectory.load(tmp_path / "growing.h5").t.tolist() == run.t.tolist()


def test_the_layout_names_what_there_is(recorded):
    """No unit and no axis is of a dataset that there is not."""
    found = nd.Trajectory.load(recorded).columns.keys()
    given = {name for name in LAYOUT if name.startswith("wrenches/")} | {ON_LINKS}  # of external forces
    assert found | given == LAYOUT.keys() and not found & given
