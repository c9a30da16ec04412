"""Outputs: complete or not at all, in place of their own kind only, through links, FIFOs and devices."""

import argparse
import os
import shutil
import threading
from pathlib import Path

import h5py
import matplotlib.figure
import numpy as np
import pytest

import nsdyn as nd
from nsdyn import cli
from nsdyn.cli import command
from nsdyn.tools import files


def write(path, text):
    with files.writing(path, files.TABLE) as part:
        part.write_text(text)


def test_replacement_is_whole_and_keeps_permissions(tmp_path):
    path = tmp_path / "f"
    path.write_text("old")
    path.chmod(0o640)
    with pytest.raises(RuntimeError), files.writing(path, files.TABLE) as part:
        part.write_text("half")
        raise RuntimeError
    assert path.read_text() == "old" and os.listdir(tmp_path) == ["f"]
    write(path, "new")
    assert path.read_text() == "new" and path.stat().st_mode & 0o777 == 0o640 and os.listdir(tmp_path) == ["f"]


@pytest.mark.parametrize("exists", [True, False])
def test_links_are_followed(tmp_path, exists):
    (tmp_path / "inner").mkdir()
    real, link = tmp_path / "inner" / "real", tmp_path / "link"
    if exists:
        real.write_text("old")
    link.symlink_to("inner/real")
    write(link, "new")
    assert link.is_symlink() and real.read_text() == "new" and not real.is_symlink()


def test_links_in_a_circle(tmp_path):
    (tmp_path / "a").symlink_to("b")
    (tmp_path / "b").symlink_to("a")
    with pytest.raises(ValueError, match=r"cannot write .*a: its links lead in a circle"):
        write(tmp_path / "a", "x")
    with pytest.raises(ValueError, match=r"cannot write .*x: its links lead in a circle"):
        write(tmp_path / "a" / "x", "x")


def test_fifo_is_written_through(tmp_path):
    fifo, got = tmp_path / "fifo", []
    os.mkfifo(fifo)
    reader = threading.Thread(target=lambda: got.append(fifo.read_text()))
    reader.start()
    write(fifo, "all of it")
    reader.join()
    assert got == ["all of it"] and fifo.is_fifo()


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="no /dev/full")
def test_device_is_written_through():
    with pytest.raises(ValueError, match="cannot write /dev/full: No space left on device"):
        write("/dev/full", "x")
    write("/dev/null", "x")
    assert not os.path.isfile("/dev/full") and not os.path.isfile("/dev/null")


def test_standard_output(capsys):
    write("-", "text")
    assert capsys.readouterr().out == "text"


@pytest.mark.parametrize(("name", "words"), [("folder", "it is a folder"), ("no/f", "there is no folder")])
def test_what_cannot_be_written(tmp_path, name, words):
    (tmp_path / "folder").mkdir()
    with pytest.raises(ValueError, match=f"cannot write .*{name}: {words}"):
        files.check_writable(tmp_path / name, files.TABLE)
    with pytest.raises(ValueError, match=f"cannot write .*{name}: {words}"):
        write(tmp_path / name, "x")


# -- kinds -------------------------------------------------------------------------------------------------------------

COMMANDS = {
    "run": ["slide"],
    "sweep": ["slide", "--set", "mu=0.2,0.5"],
    "study": ["slide", "--dt", "1e-2,5e-3"],
    "solve": ["in.hdf5"],
    "profile": ["."],
    "bench": [],
    "energy": ["in.h5"],
    "contacts": ["in.h5"],
    "view": ["in.h5"],
    "plot": ["in.h5"],
    "film": ["in.h5"],
    "joints": ["in.h5"],
    "bodies": ["in.h5"],
    "pairs": ["in.h5"],
}
"""What each command that writes needs besides."""

SUBPARSERS = next(a for a in command.parser()._actions if isinstance(a, argparse._SubParsersAction)).choices
OUTPUTS = [
    (name, option.option_strings[-1], parser.get_default("outputs")[option.dest])
    for name, parser in SUBPARSERS.items()
    for option in parser._actions
    if option.dest in (parser.get_default("outputs") or {})
]


def test_every_path_of_every_command_is_declared():
    folders = {"folder", "dump_on_fail", "package_dirs"}
    for name, parser in SUBPARSERS.items():
        known = {*(parser.get_default("inputs") or ()), *(parser.get_default("outputs") or {})} | folders
        paths = {action.dest for action in parser._actions if action.type is Path}
        assert paths <= known or name == "new"
    assert {name for name, _, _ in OUTPUTS} == COMMANDS.keys()


@pytest.fixture(scope="module")
def kinds(tmp_path_factory):
    """A file of each kind, by the kind."""
    folder = tmp_path_factory.mktemp("kinds")
    trajectory = nd.simulate(nd.scenes.load("slide")(), 0.02, dt=0.01)
    trajectory.save(folder / "in.h5")
    trajectory.to_html(folder / "in.html")
    nd.fclib.write(folder / "in.hdf5", nd.FC3D(np.eye(3), [-1.0, 0.2, 0.0], [0.5]))
    for ending in files.PICTURE.endings:
        matplotlib.figure.Figure().savefig(folder / f"in.{ending}")
    nd.sweep("slide", {"mu": [0.5]}, 0.02, dt=0.01, keep=len_of, store=folder / "in.jsonl")
    (folder / "in.mp4").write_bytes(b"\0\0\0\x20ftypisom")
    (folder / "in.parquet").write_bytes(b"PAR1")
    with h5py.File(folder / "other.h5", "w") as file:
        file["x"] = 1.0
    return folder


def len_of(trajectory):
    return trajectory.steps


OF = {
    "in.h5": "recording",
    "in.html": "page",
    "in.hdf5": "contact problem",
    "in.png": "picture",
    "in.pdf": "picture",
    "in.svg": "picture",
    "in.jsonl": "store",
    "in.mp4": "film",
    "in.parquet": "Parquet table",
    "other.h5": "HDF5 file of another program",
}


FIRST = {kind: (name, option) for name, option, kind in reversed(OUTPUTS)}


@pytest.mark.parametrize(
    ("name", "option", "kind"),
    [pytest.param(*o, marks=[] if FIRST[o[2]] == o[:2] else pytest.mark.slow) for o in OUTPUTS],
)
def test_no_output_replaces_another_kind(kinds, tmp_path, monkeypatch, capsys, name, option, kind):
    """Whatever its ending; nor does it take an ending of another kind. Nothing runs."""
    monkeypatch.chdir(shutil.copytree(kinds, tmp_path / "f"))
    before = {path.name: path.read_bytes() for path in Path().iterdir()}
    for there, what in OF.items():
        if what == kind.what:
            continue
        for path in {there, f"{there}.{kind.endings[0]}"}:
            if path != there:
                shutil.copy(there, path)
            given = [value for value in COMMANDS[name] if value != path]
            if len(given) < len(COMMANDS[name]):  # it is read
                continue
            assert cli.main([name, *given, option, path]) == 2
            out, err = capsys.readouterr()
            words = f"the file there is a {what}, no {kind.what}; remove it first"
            if there == path and Path(path).suffix[1:] not in kind.endings:
                words = f"a {kind.what} must be {' or '.join(kind.endings)}, got {Path(path).suffix}"
            assert out == "" and err == f"nsdyn: error: cannot write {path}: {words}\n"
            assert Path(path).read_bytes() == before[there]
            if path != there:
                Path(path).unlink()
    assert {path.name: path.read_bytes() for path in Path().iterdir()} == before


def test_neither_does_python(kinds, tmp_path):
    """A page over a recording, a recording over a page, a problem over a recording; a damaged recording may go."""
    trajectory = nd.Trajectory.load(kinds / "in.h5")
    problem, scene = nd.FC3D(np.eye(3), [-1.0, 0.2, 0.0], [0.5]), nd.scenes.load("slide")()
    page, recording = (shutil.copy(kinds / name, tmp_path) for name in ("in.html", "in.h5"))
    bare = shutil.copy(page, tmp_path / "bare")
    for write, path in (
        (trajectory.to_html, recording),
        (trajectory.save, page),
        (trajectory.save, bare),
        (lambda path: nd.simulate(scene, 0.02, dt=0.01, record=path), bare),
        (lambda path: nd.fclib.write(path, problem, overwrite=True), recording),
    ):
        before = Path(path).read_bytes()
        with pytest.raises(ValueError, match=f"cannot write {path}: "):
            write(path)
        assert Path(path).read_bytes() == before
    Path(recording).write_bytes(Path(recording).read_bytes()[:3000])
    trajectory.save(recording)
    assert nd.Trajectory.load(recording).steps == trajectory.steps


def test_what_is_no_path_is_told():
    slide = nd.scenes.load("slide")()
    run, problem = nd.simulate(slide, 0.01, 1e-2), nd.FC3D(np.eye(3), [-1.0, 0.0, 0.0], [0.5])
    given = (
        nd.Trajectory.load,
        run.save,
        run.to_html,
        run.table("bodies").to_csv,
        nd.fclib.read,
        lambda path: nd.fclib.write(path, problem),
        lambda path: nd.sweep("slide", {}, 0.01, dt=1e-2, keep=str, store=path),
    )
    for takes in given:
        with pytest.raises(ValueError, match=r"(path|store) must be a path, got 3"):
            takes(3)
