"""Files from strangers are data: a clear error, no crash, no path outside the folders given, no memory beyond them."""

import os
import resource
import shutil
import signal
import subprocess
import sys

import anything
import coal
import fuzz
import h5py
import numpy as np
import pytest
from conftest import INERTIAL

import nsdyn as nd
from nsdyn.audit.findings import TOLERANCES
from nsdyn.scene import meshes
from nsdyn.scene.mesh_files import stl
from nsdyn.tools import datasets


@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=pytest.mark.slow if n in ("recording", "fclib") else []) for n in fuzz.READERS]
)
def test_damaged_files_are_read_or_refused(name):
    tally = fuzz.run(name, 60, 2, None)
    assert tally["read"] + tally["refused"] == sum(tally.values()) == 60


@pytest.mark.slow
@pytest.mark.parametrize("name", fuzz.READERS)
def test_many_damaged_files_are_read_or_refused(name):
    tally = fuzz.run(name, 600, 3, None)
    assert tally["read"] + tally["refused"] == sum(tally.values()) == 600


@pytest.mark.slow
def test_the_fuzzer_takes_crashes_and_hangs(monkeypatch):
    """Readers that end the process, never return, take memory, and raise what they may not."""

    def use(path):
        kind = path.read_bytes()[:1]
        if kind == b"c":
            os.kill(os.getpid(), signal.SIGKILL)
        while kind == b"h":
            pass
        if kind == b"m":
            bytearray(10**12)
        if kind == b"o":
            raise KeyError("x")
        if kind == b"u":
            raise ValueError("who knows")

    monkeypatch.setattr(fuzz, "SECONDS", 1.0)
    monkeypatch.setitem(fuzz.READERS, "bad", fuzz.Reader(".x", lambda _: [b"r"], use))
    cases = iter(b"rchmou")
    sent = [bytes([next(cases)]) for _ in range(6)]
    monkeypatch.setattr(fuzz, "mutated", lambda good, text, rng: sent[int(rng.bit_generator.seed_seq.entropy[1])])
    tally = fuzz.run("bad", 6, 0, None)
    assert {kind.split(" with")[0] for kind in tally} == {"read", "crash", "hang", "memory", "KeyError", "unnamed"}


# -- meshes --------------------------------------------------------------------------------------------------------

GOOD = {
    "binary.stl": fuzz.binary_stl(),
    "text.stl": fuzz.text_stl(),
    "box.obj": fuzz.obj(),
    "text.ply": fuzz.ply(False),
    "binary.ply": fuzz.ply(True),
    "box.dae": fuzz.dae(),
}


@pytest.mark.parametrize("name", GOOD)
def test_meshes_of_every_format(name, tmp_path):
    """The box of all of them, as Coal reads it too, by another library."""
    path = tmp_path / name
    path.write_bytes(GOOD[name])
    surface = meshes.read(path)
    assert surface.volume == pytest.approx(0.006, rel=1e-6)  # digits of single precision
    theirs = np.unique(np.round(coal.MeshLoader().load(str(path), np.ones(3)).vertices(), 6), axis=0)
    np.testing.assert_allclose(np.unique(np.round(surface.vertices, 6), axis=0), theirs, rtol=0, atol=1e-6)


def test_nodes_of_collada_are_moved(tmp_path):
    """A node in a node, turned, scaled and moved: as Coal reads it."""
    inner = '<node id="i"><translate>1 2 3</translate><rotate>0 0 1 30</rotate><scale>1 2 1</scale>'
    text = fuzz.dae().decode().replace('<node id="n">', f'<node id="n"><matrix>{MATRIX}</matrix>{inner}')
    (tmp_path / "box.dae").write_text(text.replace("</node>", "</node></node>"))
    surface = meshes.read(tmp_path / "box.dae")
    theirs = np.array(coal.MeshLoader().load(str(tmp_path / "box.dae"), np.ones(3)).vertices())
    np.testing.assert_allclose(surface.vertices.mean(axis=0), theirs.mean(axis=0), rtol=1e-6)
    assert surface.volume == pytest.approx(0.012, rel=1e-6)


MATRIX = "0 -1 0 5  1 0 0 6  0 0 1 7  0 0 0 1"


def test_polygons_are_cut_into_triangles(tmp_path):
    corners = "".join(f"v {x} {y} {z}\n" for x, y, z in fuzz.CORNERS)
    faces = "".join("f " + " ".join(str(k + 1) for k in quad) + "\n" for quad in fuzz.QUADS)
    (tmp_path / "box.obj").write_text("mtllib /dev/zero\n" + corners + faces.replace("f 1 2", "f -8 -7"))
    surface = meshes.read(tmp_path / "box.obj")
    assert len(surface.triangles) == 12 and surface.volume == pytest.approx(0.006, rel=1e-12)


def test_a_mesh_is_written_as_it_is_read(tmp_path):
    (tmp_path / "box.ply").write_bytes(fuzz.ply(True))
    surface = meshes.read(tmp_path / "box.ply")
    (tmp_path / "box.stl").write_bytes(stl.binary(surface.vertices, surface.triangles))
    again = meshes.read(tmp_path / "box.stl")
    np.testing.assert_array_equal(again.vertices[again.triangles], surface.vertices[surface.triangles])


@pytest.mark.parametrize(
    ("name", "data", "words"),
    [
        ("a.glb", b"glTF", r"must be a mesh in one of \.stl, \.obj, \.ply, \.dae: convert it"),
        ("a.stl", bytes(80) + b"\xff\xff\xff\xff", "84 bytes, where 4294967295 facets take 214748364834"),
        ("a.obj", b"v 0 0 0\nf 1 2 3\n", "faces must have corners 1 to 1, got 'f 1 2 3'"),
        (
            "a.ply",
            fuzz.ply(True).replace(b"vertex 8", b"vertex 80000000"),
            "it has 80000000 of vertex and only .* left",
        ),
        ("a.ply", fuzz.ply(False).replace(b"\n3 0", b"\n99 0"), "must have as many values as there are, got 99"),
        ("a.ply", fuzz.ply(False).replace(b"\n3 0 1", b"\n3 0 1.5"), "corners of its faces must be whole numbers"),
        ("a.dae", fuzz.dae().replace(b"<p>0 1", b"<p>0 1.5"), "<p> must be whole numbers"),
        ("a.dae", fuzz.dae().replace(b'url="#g"', b'url="#s"'), "names '#s', which is no <geometry> of the file"),
        ("a.dae", fuzz.dae().replace(b"<instance_geometry", b'<instance_node url="#n"/><instance_geometry'), "deep"),
    ],
)
def test_bad_meshes_are_told(name, data, words, tmp_path):
    (tmp_path / name).write_bytes(data)
    with pytest.raises(ValueError, match=words):
        nd.Scene().add_mesh("m", tmp_path / name, 1.0)


# -- robots --------------------------------------------------------------------------------------------------------


@pytest.fixture
def outside(tmp_path):
    """A folder with a robot's file in it and a mesh beside the folder."""
    (tmp_path / "robot").mkdir()
    (tmp_path / "secret.stl").write_bytes(fuzz.binary_stl())
    (tmp_path / "robot" / "box.stl").write_bytes(fuzz.binary_stl())
    (tmp_path / "robot" / "link.stl").symlink_to(tmp_path / "secret.stl")
    return tmp_path / "robot"


@pytest.mark.parametrize(
    ("uri", "words"),
    [
        ("../secret.stl", r"must not go up by '\.\.'"),
        ("package://robot/../secret.stl", r"must not go up by '\.\.'"),
        ("package://../secret.stl", r"must not go up by '\.\.'"),
        ("file://{}/../secret.stl", r"must not go up by '\.\.'"),
        ("{}.stl", "lies outside of"),
        ("file://{}.stl", "lies outside of"),
        ("link.stl", "lies outside of"),
        ("A" * 5000, "was not found"),
    ],
)
def test_meshes_outside_the_folders_are_refused(outside, uri, words):
    uri = uri.format(outside.parent / "secret" if ".." not in uri else outside)
    urdf = f'<robot name="r"><link name="b">{INERTIAL}<collision><geometry><mesh filename="{uri}"/></geometry>'
    (outside / "r.urdf").write_text(urdf + "</collision></link></robot>")
    mass = "<inertial><mass>1</mass></inertial>"
    sdf = f"<sdf version='1.9'><model name='m'><link name='b'>{mass}<collision name='c'><geometry><mesh><uri>{uri}"
    (outside / "r.sdf").write_text(sdf + "</uri></mesh></geometry></collision></link></model></sdf>")
    mjcf = f'<mujoco><asset><mesh name="m" file="{uri.removeprefix("file://")}"/></asset><worldbody><body>'
    (outside / "r.xml").write_text(mjcf + '<freejoint/><geom type="mesh" mesh="m"/></body></worldbody></mujoco>')
    with pytest.raises(ValueError, match=words):
        nd.Scene().add_urdf("r", outside / "r.urdf")
    with pytest.raises(ValueError, match=words):
        nd.Scene().add_sdf("r", outside / "r.sdf")
    if "package" not in uri:
        with pytest.raises(ValueError, match=words):
            nd.Scene().add_mjcf("r", outside / "r.xml")


def test_a_folder_that_is_given_is_inside(outside):
    urdf = (
        f'<robot name="r"><link name="b">{INERTIAL}<collision><geometry><mesh filename="{outside.parent}/secret.stl"/>'
    )
    (outside / "r.urdf").write_text(urdf + "</geometry></collision></link></robot>")
    scene = nd.Scene()
    scene.add_urdf("r", outside / "r.urdf", package_dirs=[outside / ".."])
    assert len(scene.articulations["r"].links) == 1


@pytest.mark.parametrize(
    ("include", "words"),
    [
        ("../other.xml", r"must not go up by '\.\.'"),
        ("/etc/passwd", "lies outside of"),
        ("r.xml", "must not come twice"),
        ("twice.xml", "must not come twice"),
    ],
)
def test_includes_are_inside_and_once(outside, include, words):
    (outside / "twice.xml").write_text('<mujoco><include file="box.xml"/><include file="box.xml"/></mujoco>')
    (outside / "box.xml").write_text("<mujoco/>")
    (outside / "r.xml").write_text(f'<mujoco><include file="{include}"/><worldbody/></mujoco>')
    with pytest.raises(ValueError, match=words):
        nd.Scene().add_mjcf("r", outside / "r.xml")


def test_what_grows_beyond_its_file_is_refused(tmp_path):
    """Elements in each other, entities of entities, trees whose tables fill the memory."""
    path = tmp_path / "r.xml"
    path.write_text("<mujoco><worldbody>" + "<body>" * 500 + "</body>" * 500 + "</worldbody></mujoco>")
    with pytest.raises(ValueError, match="more than 400 deep in each other"):
        nd.Scene().add_mjcf("r", path)
    entities = "".join(f'<!ENTITY e{k + 1} "{f"&e{k};" * 10}">' for k in range(9))
    path.write_text(f'<!DOCTYPE m [<!ENTITY e0 "lol">{entities}]><mujoco>&e9;</mujoco>')
    with pytest.raises(ValueError, match="could not be read"):
        nd.Scene().add_mjcf("r", path)
    bodies = '<body><freejoint/><geom size=".1"/></body>' * 50
    path.write_text(f"<mujoco><worldbody>{bodies}</worldbody></mujoco>")
    with pytest.raises(ValueError, match="'r' has 300 coordinates, more than 256"):
        nd.Scene().add_mjcf("r", path)
    balls = '<joint type="ball"/>' * 209  # of which Pinocchio makes one joint with tables of gigabytes
    path.write_text(f'<mujoco><worldbody><body>{balls}<geom size=".1"/></body></worldbody></mujoco>')
    with pytest.raises(ValueError, match="'r' has 627 coordinates, more than 256"):
        nd.Scene().add_mjcf("r", path)


# -- HDF5 ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["huge", "external", "outside", "virtual", "soft"])
def test_fields_that_are_not_in_the_file_are_refused(tmp_path, kind):
    np.zeros(8).tofile(tmp_path / "raw")
    path = tmp_path / "p.hdf5"
    with h5py.File(path, "w") as file:
        match kind:
            case "huge":
                file.create_dataset("x", shape=(10**12,), dtype="f8", chunks=(1024,))
            case "external":
                file.create_dataset("x", shape=(8,), dtype="f8", external=str(tmp_path / "raw"))
            case "outside":
                file["x"] = h5py.ExternalLink("/etc/passwd", "/x")
            case "virtual":
                layout = h5py.VirtualLayout(shape=(8,), dtype="f8")
                layout[:] = h5py.VirtualSource(str(tmp_path / "other.h5"), "x", shape=(8,))
                file.create_virtual_dataset("x", layout)
            case "soft":
                file["y"], file["x"] = np.zeros(8), h5py.SoftLink("/y")
    with h5py.File(path) as file, pytest.raises(ValueError, match=r"^/x (is missing, or no dataset|has a size of)"):
        datasets.dataset(file, "x")


def test_zeros_that_compress_are_read(tmp_path):
    """A megabyte of zeros, the most that gzip makes of a kilobyte."""
    with h5py.File(tmp_path / "p.hdf5", "w") as file:
        file.create_dataset("x", data=np.zeros(2**17), chunks=(2**17,), compression="gzip", compression_opts=9)
        assert file["x"].id.get_storage_size() < 1100
        assert datasets.dataset(file, "x").shape == (2**17,)


@pytest.mark.parametrize("block", [64, 1 << 22])
def test_heaps_that_do_not_end_are_refused(tmp_path, monkeypatch, block):
    """HDF5 itself would read such a file for ever."""
    monkeypatch.setattr(datasets, "BLOCK", block)
    path = tmp_path / "run.h5"
    nd.simulate(nd.scenes.load("slide")(), 0.02, dt=0.01, record=path)
    data = bytearray(path.read_bytes())
    at = data.find(datasets.HEAP) + 16
    datasets.check_heaps(path)
    data[at + 8 : at + 16] = (4096 - 64).to_bytes(8, "little")  # the first text reaches to where zeros stand
    path.write_bytes(data)
    with pytest.raises(ValueError, match=r"run\.h5 is damaged: a heap of texts does not end"):
        nd.Trajectory.load(path)


# What writes files that cannot grow beyond a limit, as on a disk that is full, each told by its exception.
FULL = """
import pathlib, resource, signal, sys
import nsdyn as nd
from nsdyn.recording import recorder
from nsdyn.study.store import Store
folder = pathlib.Path(sys.argv[1])
recorder._FLUSH_SECONDS = 0.0
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
scene, problem = nd.scenes.load("slide")(), nd.FC3D([[1, 0, 0], [0, 1, 0], [0, 0, 1]], [-1, 0, 0], [0.5])
trajectory = nd.simulate(scene, 0.01)
for size, write in (
    (1500000, lambda: nd.simulate(scene, 2.0, dt=0.01, record=folder / "long.h5")),
    (1000, lambda: nd.simulate(scene, 0.01, record=folder / "run.h5")),
    (1000, lambda: nd.fclib.write(folder / "fc3d.hdf5", problem)),
    (1000, lambda: trajectory.save(folder / "saved.h5")),
    (1000, lambda: Store(folder / "out.jsonl", {"options": "x" * 5000})),
):
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, resource.RLIM_INFINITY))
    try:
        write()
    except Exception as failure:
        print(f"{type(failure).__name__}: {failure}")
"""


@pytest.fixture(scope="module")
def full(tmp_path_factory):
    """(folder, lines that were printed) of a process that writes on a full disk."""
    assert resource.getrlimit(resource.RLIMIT_FSIZE)[1] == resource.RLIM_INFINITY
    folder = tmp_path_factory.mktemp("full")
    command = [sys.executable, "-c", FULL, str(folder)]
    return folder, subprocess.run(command, capture_output=True, text=True, check=True).stdout.splitlines()


def test_a_full_disk_leaves_what_fitted(full, tmp_path):
    folder, told = full
    assert f"cannot record in {folder / 'long.h5'}: File too large" in told[0]
    path = shutil.copy(folder / "long.h5", tmp_path)
    left, whole = nd.Trajectory.load(path), nd.simulate(nd.scenes.load("slide")(), 2.0, dt=0.01)
    assert 0 < left.steps < 200
    assert left.q.tobytes() == whole.q[: left.steps + 1].tobytes()
    resumed = nd.simulate(nd.scenes.load("slide")(), 2.0, dt=0.01, resume=path)
    assert resumed.q.tobytes() == whole.q.tobytes()


def test_what_does_not_fit_on_a_disk_is_told_and_leaves_nothing(full):
    """HDF5 alone would end the process by a signal."""
    folder, told = full
    assert told[1:] == [
        *(f"ValueError: cannot write {folder / name}: File too large" for name in ("run.h5", "fc3d.hdf5", "saved.h5")),
        f"OSError: [Errno 27] cannot store the sweep in {folder / 'out.jsonl'}: File too large",
    ]
    left = {file.name: file.stat().st_size for file in folder.iterdir() if file.name != "long.h5"}
    assert left.keys() <= {"out.jsonl"} and left.get("out.jsonl", 0) <= 1000  # a line that is cut is left out


# -- scenes ---------------------------------------------------------------------------------------------------------

FINE = {"passed", "refused", "stopped", "missed, warned of", "squeezed, told"}


def tried(count, bad=False, begin=0):
    arguments = ["--count", str(count), "--begin", str(begin), "--steps", "15", *(["--bad"] if bad else [])]
    return anything.campaign(anything.parsed(arguments))


def test_random_scenes():
    tally, _, failures = tried(12)
    assert not failures and set(tally) <= FINE and tally["passed"] >= 10


@pytest.mark.slow
@pytest.mark.parametrize("scene", [50_004_338, 50_001_842])
def test_fast_bodies_do_not_sink(scene, tmp_path):
    """Impacts too many for one step at three sizes a step: what sank was lifted by twice its size."""
    _, figures = anything.outcome(*anything.random_scene(scene, tmp_path), 25)
    assert figures["motion"] < TOLERANCES["motion"] and figures["spin"] < TOLERANCES["spin"]


@pytest.mark.slow
def test_steps_cut_without_contacts_are_audited_so(tmp_path):
    """With theta 0.81 in pieces, of what seemed to touch on its way and did not: half the fall at the end of each."""
    _, figures = anything.outcome(*anything.random_scene(6306, tmp_path), 5)
    assert figures["motion"] < 1e-6


@pytest.mark.slow
def test_what_has_turned_before_it_touches_is_not_met(tmp_path):
    """A light box in a vice turns on its way: with the normal of the end it was pushed sideways where it touches."""
    _, figures = anything.outcome(*anything.random_scene(2447, tmp_path), 25)
    assert figures["normal"] < TOLERANCES["normal"]


@pytest.mark.parametrize(
    "scene", [7_770_000_900, *(pytest.param(k, marks=pytest.mark.slow) for k in (42_420_000_200, 313_370_000_250))]
)
def test_contacts_that_turn_and_go_far_create_no_energy(scene, tmp_path):
    """Bodies that turn by a radian a step, and a contact found again under the name of another: 1e-6 to 3e-5 before."""
    _, figures = anything.outcome(*anything.random_scene(scene, tmp_path), 25)
    assert figures["created"] <= 1e-7  # the bar of the script


@pytest.mark.slow
def test_many_random_scenes():
    tally, _, failures = tried(250, begin=20)
    assert not failures and set(tally) <= FINE and tally["passed"] >= 240
