"""Damaged files for every reader: a clear error, no crash, no hang, no memory beyond what the file is worth.

    python demos/bench/fuzz.py [READER]... [--count N] [--seed S]

Each case mutates one of a few good files of its reader, from a seed of its own: bytes changed, cut, repeated, thrown
in; words of a text replaced, numbers by what no number should be, elements left out or moved; fields of HDF5 files of
other types, sizes and values. A file that is read must serve: a recording is tabled, a problem solved, a robot moved
for two steps. All is done in a child process that takes the crash, with a limit on memory and time, and tells of each:

    read       and what was done with it succeeded
    refused    a ValueError that names the file
    crash, hang, memory, or the name of another exception: a failure, of which a copy is kept in --keep
"""

import argparse
import collections
import io
import mmap
import os
import re
import resource
import select
import shutil
import signal
import struct
import sys
import tempfile
import time
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import h5py
import numpy as np

import nsdyn as nd
from nsdyn.recording import file as recording

SECONDS = 20.0
"""That a case may take."""

MEMORY, MULTIPLE = 256_000_000, 1100
"""Bytes beyond those of the process at its start, which solving and stepping take, and for each byte of the
smallest good file, as gzip makes of zeros."""

TREE = 4_000_000_000
"""Bytes for a robot: Pinocchio's tables of the most coordinates that are taken, 256, are 1 GB."""

BATCH = 500
"""Cases of one child, so that what a library leaks does not count."""

ROOT = Path(__file__).resolve().parents[2]
DATA = ROOT / "tests" / "data"

# -- good files ----------------------------------------------------------------------------------------------------

CORNERS = np.array(list(np.ndindex(2, 2, 2))) * (0.1, 0.2, 0.3)
QUADS = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
TRIANGLES = [t for a, b, c, d in QUADS for t in ((a, b, c), (a, c, d))]


def binary_stl() -> bytes:
    """A box."""
    faces = (struct.pack("<12fH", 0, 0, 0, *CORNERS[list(t)].ravel(), 0) for t in TRIANGLES)
    return bytes(80) + struct.pack("<I", len(TRIANGLES)) + b"".join(faces)


def text_stl() -> bytes:
    """The same as text."""
    facets = []
    for t in TRIANGLES:
        corners = "".join(f"vertex {x:g} {y:g} {z:g}\n" for x, y, z in CORNERS[list(t)])
        facets.append(f"facet normal 0 0 0\nouter loop\n{corners}endloop\nendfacet\n")
    return f"solid box\n{''.join(facets)}endsolid box\n".encode()


def obj() -> bytes:
    """The same with shared corners."""
    corners = "".join(f"v {x:g} {y:g} {z:g}\n" for x, y, z in CORNERS)
    return (corners + "".join(f"f {a + 1}//{a + 1} {b + 1} {c + 1}\n" for a, b, c in TRIANGLES)).encode()


def ply(binary: bool) -> bytes:
    """The same."""
    kind = "binary_little_endian" if binary else "ascii"
    header = (
        f"ply\nformat {kind} 1.0\nelement vertex 8\nproperty float x\nproperty float y\nproperty float z\n"
        f"element face {len(TRIANGLES)}\nproperty list uchar int vertex_indices\nend_header\n"
    ).encode()
    if binary:
        faces = b"".join(struct.pack("<B3i", 3, *t) for t in TRIANGLES)
        return header + CORNERS.astype("<f4").tobytes() + faces
    corners = "".join(f"{x:g} {y:g} {z:g}\n" for x, y, z in CORNERS)
    return header + (corners + "".join(f"3 {a} {b} {c}\n" for a, b, c in TRIANGLES)).encode()


def dae() -> bytes:
    """The same in COLLADA."""
    corners, faces = " ".join(map(str, CORNERS.ravel())), " ".join(str(k) for t in TRIANGLES for k in t)
    return f"""<?xml version="1.0"?>
<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1"><asset><unit meter="1"/>
<up_axis>Z_UP</up_axis></asset><library_geometries><geometry id="g"><mesh>
<source id="p"><float_array id="pa" count="24">{corners}</float_array><technique_common>
<accessor source="#pa" count="8" stride="3"><param name="X" type="float"/><param name="Y" type="float"/>
<param name="Z" type="float"/></accessor></technique_common></source>
<vertices id="v"><input semantic="POSITION" source="#p"/></vertices>
<triangles count="{len(TRIANGLES)}"><input semantic="VERTEX" source="#v" offset="0"/><p>{faces}</p></triangles>
</mesh></geometry></library_geometries><library_visual_scenes><visual_scene id="s"><node id="n">
<instance_geometry url="#g"/></node></visual_scene></library_visual_scenes>
<scene><instance_visual_scene url="#s"/></scene></COLLADA>
""".encode()


def recordings(folder: Path) -> list[bytes]:
    """Of a few steps, with and without articulations, complete and as a killed run leaves them."""
    out = []
    for name, steps in (("stack", 5), ("gripper", 5)):
        setup = nd.scenes.setup(name)
        path = folder / f"{name}.h5"
        nd.simulate(setup.scene, steps * setup.dt, **setup.options(), record=path)
        out.append(path.read_bytes())
        meta, scene, columns, state = recording.read_state(path)
        recording.create(path, (meta, scene, columns), grow=True, state=state)
        out.append(path.read_bytes())
    return out


def problems(folder: Path) -> list[bytes]:
    """Local and global, the latter beside a solution and a guess."""
    out = [(DATA / name).read_bytes() for name in ("rod.hdf5", "stack.hdf5", "quadruped.hdf5")]
    W = np.eye(6) + 0.1
    problem = nd.FC3D(W, np.array([-1.0, 2.0, 0.0, -1.0, 0.1, 0.0]), np.full(2, 0.5))
    solution = nd.solve(problem)
    nd.fclib.write(folder / "p.hdf5", problem, solution, guesses=[solution.r])
    return [*out, (folder / "p.hdf5").read_bytes()]


# -- what is done with a file --------------------------------------------------------------------------------------


def use_recording(path: Path) -> None:
    """Read all of it, and what a run would go on from."""
    trajectory = nd.Trajectory.load(path)
    recording.read_state(path)
    trajectory.energy_table()
    for name in trajectory.scene["frames"]:
        trajectory.body(name)
    if trajectory.has_contacts and trajectory.steps:
        trajectory.contacts(-1)


def use_problem(path: Path) -> None:
    """Solve it, a little."""
    problem = nd.fclib.read(path)
    nd.fclib.read_solution(path)
    nd.fclib.read_guesses(path)
    nd.solve(problem, nd.solvers.PGS(tol=1e-4, max_iter=10))


def moved(scene: nd.Scene) -> None:
    """Two steps, which may not be solved, but not wrong in silence."""
    stepper = nd.Stepper(scene, 1e-3)
    for _ in range(2):
        try:
            step = stepper.step()
        except nd.NotConverged:
            return
        if not (np.isfinite(step.q).all() and np.isfinite(step.v).all()):
            raise ArithmeticError("the state is not finite")


def use_robot(add: str, **given: Any) -> Callable[[Path], None]:
    """Read a robot and move it."""

    def use(path: Path) -> None:
        scene = nd.Scene()
        getattr(scene, add)("robot", path, inertias="trust", clip=True, self_collisions="apart", **given)
        moved(scene)

    return use


def use_mesh(path: Path) -> None:
    """Its hull as a body that falls."""
    scene = nd.Scene()
    scene.add_mesh("mesh", path, mass=1.0)
    moved(scene)


class Reader(NamedTuple):
    """A kind of files.

    Attributes
    ----------
    suffix : str
    make : callable
        Good files, made in a folder.
    use : callable
        Reads one and does something with it; ValueError for a damaged one.
    """

    suffix: str
    make: Callable[[Path], list[bytes]]
    use: Callable[[Path], None]


def folders() -> list[Path]:
    """Where meshes are looked up: the folder of the case."""
    return [Path(os.environ["FUZZ_FOLDER"])]


READERS = {
    "recording": Reader(".h5", recordings, use_recording),
    "fclib": Reader(".hdf5", problems, use_problem),
    "urdf": Reader(
        ".urdf",
        lambda _: [path.read_bytes() for path in (DATA / "robot.urdf", *sorted((ROOT / "models").glob("*.urdf")))],
        use_robot("add_urdf"),
    ),
    "mjcf": Reader(".xml", lambda _: [(DATA / "robot.xml").read_bytes()], use_robot("add_mjcf")),
    "sdf": Reader(".sdf", lambda _: [(DATA / "robot.sdf").read_bytes()], use_robot("add_sdf")),
    "stl": Reader(".stl", lambda _: [binary_stl(), text_stl()], use_mesh),
    "obj": Reader(".obj", lambda _: [obj()], use_mesh),
    "ply": Reader(".ply", lambda _: [ply(False), ply(True)], use_mesh),
    "dae": Reader(".dae", lambda _: [dae()], use_mesh),
}

# -- mutations -----------------------------------------------------------------------------------------------------

Rng = np.random.Generator

ODD = [
    "nan",
    "inf",
    "-inf",
    "0",
    "-0",
    "-1",
    "1e308",
    "-1e308",
    "1e-308",
    "1e39",
    "1e20",
    "1e-20",
    "2147483647",
    "-2147483648",
    "4294967296",
    "18446744073709551616",
    "99999999999999999999999",
    "",
    "x",
    "1 2",
    "1e999",
    "0x10",
    "1,5",
    "\u00bd",
    "../../../etc/passwd",
    "/dev/zero",
    "package://",
    "file:///dev/zero",
    "&lt;",
    "%s%n",
    "A" * 5000,
]
"""In place of a word of a text."""


def flipped(data: bytes, rng: Rng) -> bytes:
    """Some bytes changed."""
    out = bytearray(data)
    for _ in range(rng.integers(1, 9)):
        out[rng.integers(len(out))] = rng.choice([0, 1, 0x7F, 0x80, 0xFF, rng.integers(256)])
    return bytes(out)


def cut(data: bytes, rng: Rng) -> bytes:
    """Its beginning."""
    return data[: rng.integers(len(data))]


def without(data: bytes, rng: Rng) -> bytes:
    """A part left out."""
    a = rng.integers(len(data))
    return data[:a] + data[a + rng.integers(1, 200) :]


def repeated(data: bytes, rng: Rng) -> bytes:
    """A part copied to another place, up to many times."""
    a, b = rng.integers(len(data), size=2)
    part = data[a : a + rng.integers(1, 400)]
    return data[:b] + part * int(rng.choice([1, 2, 50])) + data[b:]


def thrown_in(data: bytes, rng: Rng) -> bytes:
    """Random bytes somewhere."""
    a = rng.integers(len(data))
    return data[:a] + rng.bytes(rng.integers(1, 64)) + data[a:]


def noise(data: bytes, rng: Rng) -> bytes:
    """Nothing but random bytes, perhaps behind the first ones of the file."""
    return data[: rng.choice([0, 8, 80])] + rng.bytes(rng.integers(0, 2000))


def words(data: bytes, rng: Rng) -> bytes:
    """Words and numbers of a text replaced by odd ones, or by others of the text."""
    text = data.decode(errors="replace")
    for _ in range(rng.integers(1, 5)):
        found = list(re.finditer(r"[-+.\w]+", text))
        if not found:
            break
        word, other = (found[k] for k in rng.integers(len(found), size=2))
        new = other[0] if rng.uniform() < 0.4 else str(rng.choice(ODD))
        text = text[: word.start()] + new + text[word.end() :]
    return text.encode()


def values(data: bytes, rng: Rng) -> bytes:
    """A number of a text replaced by an odd one, or by another of the text."""
    text = data.decode(errors="replace")
    found = list(re.finditer(r"(?<![\w.])-?[\d.]+(?![\w.])", text))
    if not found:
        return data
    number, other = (found[k] for k in rng.integers(len(found), size=2))
    new = other[0] if rng.uniform() < 0.4 else str(rng.choice(ODD[:18]))
    return (text[: number.start()] + new + text[number.end() :]).encode()


def elements(data: bytes, rng: Rng) -> bytes:
    """Lines or elements of a text left out, repeated, nested or moved."""
    parts = re.split(rb"(?<=>)|(?<=\n)", data)
    for _ in range(rng.integers(1, 4)):
        a, b = rng.integers(len(parts), size=2)
        match rng.integers(5):
            case 0:
                del parts[a]
            case 1:
                parts.insert(b, parts[a])
            case 2:
                parts[a], parts[b] = parts[b], parts[a]
            case 3:
                parts[a] = parts[a] * int(rng.choice([2, 100, 300]))
            case 4:
                parts[min(a, b) : max(a, b)] = parts[min(a, b) : max(a, b)] * int(rng.choice([2, 5]))
        if not parts:
            break
    return b"".join(parts)


def fields(data: bytes, rng: Rng) -> bytes:
    """An HDF5 file with some of its fields of other types, sizes or values, or gone."""
    buffer = io.BytesIO(data)
    with h5py.File(buffer, "r+") as file:
        names: list[str] = []
        file.visit(names.append)
        for _ in range(rng.integers(1, 3)):
            name = names[rng.integers(len(names))]
            if name not in file:
                continue
            item = file.get(name)
            if item is None:
                continue
            if isinstance(item, h5py.Group) or rng.uniform() < 0.1:
                changed_group(file, name, rng)
                continue
            if not item.size or item.size > 10**6:  # changed before
                continue
            found = item[()]
            if item.dtype.kind == "O":  # a text, or several
                changed_text(file, name, b"\n".join(np.atleast_1d(found).tolist()), rng)
                continue
            del file[name]
            changed_field(file, name, found, rng)
    return buffer.getvalue()


def changed_group(file: Any, name: str, rng: Rng) -> None:
    """Leave it out, or change an attribute of it."""
    keys = list(file[name].attrs)
    if not keys or rng.uniform() < 0.5:
        del file[name]
    else:
        odd = [np.nan, -1, 2**40, "", "x", b"\xff", np.zeros(3), h5py.Empty("f8")]
        file[name].attrs[keys[rng.integers(len(keys))]] = odd[rng.integers(len(odd))]


def changed_text(file: Any, name: str, text: bytes, rng: Rng) -> None:
    """A text of JSON with words, numbers or parts of it changed."""
    kinds: list[Callable[[bytes, Rng], bytes]] = [values, words, without, repeated, cut]
    text = kinds[rng.integers(len(kinds))](text, rng)
    del file[name]
    file[name] = text.decode(errors="replace").replace("\0", " ")


def changed_field(file: Any, name: str, data: Any, rng: Rng) -> None:
    """A field in the place of another that had some values."""
    flat = np.atleast_1d(data)
    match rng.integers(9):
        case 0:  # as long as a file may say, and nothing in it
            huge = int(rng.choice([10**7, 10**9, 10**12]))
            file.create_dataset(name, shape=(huge, *flat.shape[1:]), dtype="f8", chunks=True)
        case 1:
            rows = int(rng.choice([0, 1, max(0, len(flat) - 1), len(flat) + 1]))
            file.create_dataset(name, data=np.resize(flat, (rows, *flat.shape[1:])))
        case 2:
            file.create_dataset(name, data=flat[..., None])
        case 3:
            file.create_dataset(name, data="text")
        case 4:
            file.create_dataset(name, data=h5py.Empty("f8"))
        case 5:
            file.create_group(name)
        case 6:
            file[name] = h5py.SoftLink("/nowhere") if rng.uniform() < 0.5 else h5py.ExternalLink("/etc/passwd", "/x")
        case 7 if flat.dtype.kind in "iuf" and flat.size:
            out = flat.copy().ravel()
            odd = [np.nan, np.inf, -1.0, 1e308, -1e308, 0.0] if flat.dtype.kind == "f" else [-1, 0, 7, 2**31 - 1]
            for k in rng.integers(out.size, size=rng.integers(1, 4)):
                out[k] = np.asarray(rng.choice(odd)).astype(out.dtype)
            file.create_dataset(name, data=out.reshape(np.shape(data)))
        case _:  # a small one that compresses as hardly anything does
            rows = 2**20 // max(1, flat[0].size if len(flat) else 1)
            file.create_dataset(name, data=np.zeros((rows, *flat.shape[1:])), chunks=True, compression="gzip")


BYTES = [flipped, cut, without, repeated, thrown_in, noise]


def mutated(good: list[bytes], text: bool, rng: Rng) -> bytes:
    """One of the good files, damaged once or twice."""
    data = good[rng.integers(len(good))]
    kinds = [*BYTES, *([values] * 8 + [words] * 4 + [elements] * 3 if text else [])]
    if data.startswith(b"\x89HDF") and rng.uniform() < 0.5:
        return fields(data, rng)
    for _ in range(rng.integers(1, 3)):
        if data:
            data = kinds[rng.integers(len(kinds))](data, rng)
    return data


# -- the child, and who watches it ---------------------------------------------------------------------------------


def outcome(reader: Reader, path: Path) -> str:
    """What came of a file."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            reader.use(path)
        except ValueError as refused:
            told = any(culprit in str(refused) for culprit in (path.name, "'robot", "'loop'", "step "))
            return "refused" if told else f"unnamed: {refused}"
        except MemoryError:
            return "memory"
        except Exception as other:  # whatever it is, it is the finding
            return f"{type(other).__name__}: {other}"
    return "read"


def limit_memory(more: int) -> None:
    """Let this process have no more than so many bytes beyond what it has."""
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    most = pages * resource.getpagesize() + more
    resource.setrlimit(resource.RLIMIT_AS, (most, most))


def work(reader: Reader, good: list[bytes], seed: int, cases: range, path: Path, at: mmap.mmap, out: int) -> None:
    """The child: all cases, each begun by its number in `at`, its outcome a line in the pipe `out`."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), 2)
    robot = reader.suffix in (".urdf", ".xml", ".sdf")
    limit_memory(TREE if robot else MEMORY + MULTIPLE * min(map(len, good)))
    text = reader.suffix not in (".h5", ".hdf5")
    for case in cases:
        path.write_bytes(mutated(good, text, np.random.default_rng([seed, case])))
        at[:8] = struct.pack("<q", case)
        start = time.perf_counter()
        found = " ".join(outcome(reader, path).split())[:300]
        os.write(out, f"{case}\t{time.perf_counter() - start:.3f}\t{found}\n".encode())


def run(name: str, count: int, seed: int, keep: Path | None, begin: int = 0) -> collections.Counter[str]:
    """How often each outcome came of some cases of a reader; failures are told on stderr."""
    reader, tally, slowest = READERS[name], collections.Counter[str](), (0.0, 0)
    at = mmap.mmap(-1, 8)
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        good = reader.make(folder)
        (folder / "thing").mkdir()
        (folder / "thing" / "box.stl").write_bytes(binary_stl())
        (folder / "box.stl").write_bytes(binary_stl())
        shutil.copy(DATA / "assets.xml", folder)
        path, begin, end = folder / f"case{reader.suffix}", begin, begin + count
        nd.Scene()  # what is imported late is imported before the limit on memory
        path.write_bytes(good[0])
        print(f"{name}: the good files are {[_good(reader, path, data) for data in good]}", file=sys.stderr)
        while begin < end:
            cases = range(begin, min(end, begin + BATCH))
            source, sink = os.pipe()
            pid = os.fork()
            if pid == 0:
                os.close(source)
                work(reader, good, seed, cases, path, at, sink)
                os._exit(0)
            os.close(sink)
            lines, hung = watched(source, pid, at)
            _, status = os.waitpid(pid, 0)
            for line in lines:
                case, seconds, found = line.split("\t", 2)
                slowest = max(slowest, (float(seconds), int(case)))
                tell(name, good, reader, seed, int(case), found, tally, keep)
            begin = cases.start + len(lines)
            if begin < cases.stop:  # it died in this one
                died = "hang" if hung else f"crash with status {status}"
                tell(name, good, reader, seed, begin, died, tally, keep)
                begin += 1
    longest = f"longest {slowest[0]:.2f} s ({slowest[1]})"
    print(f"{name:10} {sum(tally.values()):7} cases, {longest}: {dict(tally)}", flush=True)
    return tally


def _good(reader: Reader, path: Path, data: bytes) -> str:
    path.write_bytes(data)
    return outcome(reader, path)


def watched(source: int, pid: int, at: mmap.mmap) -> tuple[list[str], bool]:
    """The lines of a child until it ends, or takes too long for a case and is killed; whether it was."""
    data, last, since, hung = b"", at[:8], time.perf_counter(), False
    while True:
        if select.select([source], [], [], 0.5)[0]:
            more = os.read(source, 1 << 16)
            if not more:
                break
            data += more
        if at[:8] != last:
            last, since = at[:8], time.perf_counter()
        elif not hung and time.perf_counter() - since > SECONDS:
            hung = True
            os.kill(pid, signal.SIGKILL)
    os.close(source)
    return data.decode().splitlines(), hung


def tell(
    name: str,
    good: list[bytes],
    reader: Reader,
    seed: int,
    case: int,
    found: str,
    tally: collections.Counter[str],
    keep: Path | None,
) -> None:
    """Count an outcome; a failure is shown, and a copy of its file kept."""
    kind = found.split(":")[0]
    tally[kind] += 1
    if kind in ("read", "refused"):
        return
    print(f"{name} {case}: {found}", file=sys.stderr, flush=True)
    if keep is not None:
        keep.mkdir(parents=True, exist_ok=True)
        data = mutated(good, reader.suffix not in (".h5", ".hdf5"), np.random.default_rng([seed, case]))
        (keep / f"{name}-{case}{reader.suffix}").write_bytes(data)


def main() -> int:
    """Exit code: 0 if every file was read or refused."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("reader", nargs="*", choices=[*READERS, []], help="default: all")
    parser.add_argument("--count", type=int, default=1000, help="cases of each reader (default: %(default)s)")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--begin", type=int, default=0, help="first case (default: %(default)s)")
    parser.add_argument("--keep", type=Path, help="folder for the files of failures")
    arguments = parser.parse_args()
    failures = 0
    for name in arguments.reader or READERS:
        tally = run(name, arguments.count, arguments.seed, arguments.keep, arguments.begin)
        failures += sum(tally.values()) - tally["read"] - tally["refused"]
    print(f"{failures} failures")
    return 1 if failures else 0


if __name__ == "__main__":
    sys.exit(main())
