"""Outputs: complete or not at all, through links, FIFOs and devices."""

import os
import threading

import pytest

from nsdyn.tools import files


def write(path, text):
    with files.writing(path) as part:
        part.write_text(text)


def test_replacement_is_whole_and_keeps_permissions(tmp_path):
    path = tmp_path / "f"
    path.write_text("old")
    path.chmod(0o640)
    with pytest.raises(RuntimeError), files.writing(path) as part:
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
        files.check_writable(tmp_path / name)
    with pytest.raises(ValueError, match=f"cannot write .*{name}: {words}"):
        write(tmp_path / name, "x")
