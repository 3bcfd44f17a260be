"""Compiled kernels are cached, invalidated when their source changes, and shared where possible."""

from __future__ import annotations

import os
import shutil
import stat
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest

from app import system
from tests.readme import PROJECT

PART = """
from app.compiled import compiled

@compiled()
def part(x):
    return {factor} * x
"""
THROUGH = """
from app.compiled import compiled
from part import part

@compiled()
def through(x):
    return part(x)
"""
KERNEL = """
from app.compiled import compiled
from through import through

@compiled("f8(f8)")
def kernel(x):
    return through(x)

print(kernel(2.0), len(kernel.signatures), len(kernel.stats.cache_misses))
"""
NOWHERE = """
import app.kernel_store
app.kernel_store._folders = lambda file, make: []  # as if no folder were writable
"""

CHECKED = """
from types import SimpleNamespace
import numpy as np
from app.errors import MeasurementError
from app.robot.state import Measurement, checked

shapes = (((3,), (2,), (2,), (2,), (0,)),)
two = SimpleNamespace(n_b=2, n_m=2, n_d=0, reading_shapes=shapes)
taken = checked(Measurement([0, 0, 0], [0, 0], [0, 0], np.zeros(2, "f4")), two)
print({each.dtype.name for each in taken[:4]})
try:
    checked(Measurement(np.zeros((3, 1)), *np.zeros((3, 2))), two)
except MeasurementError as error:
    print(error)
"""

MEMORY = """
import resource
import numpy as np
from app.compiled import compiled

@compiled("f8[::1](f8[:])")
def tripled(x):
    doubled = np.concatenate((x + x, np.ones(3)))
    return x + doubled[: len(x)]

sizes = (0, 1, 8, 9, 125, 128, 129, 5000)
kept = [tripled(np.full(size, 1.0 + k)) for k in range(40) for size in sizes]
print(all((x == 3.0 * (1 + k // len(sizes))).all() for k, x in enumerate(kept)))
del kept
begin = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
for k in range(200_000):
    tripled(np.ones(sizes[k % len(sizes)]))
print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - begin < 20_000)
"""

BESIDE = """
import numba
import numpy as np
from app.compiled import compiled

@compiled("f8[::1](f8)")
def eight(x):  # all its arrays have one size: the optimiser omits the size in each allocation
    return np.full(8, x)

@compiled("f8(f8[:,::1], f8[::1])")
def solved(A, b):  # `solve` is a module of numba
    return np.linalg.solve(A, b).sum()

@numba.njit
def square(n):
    return np.full((n, n), 3.0)

eight(1.0)
kept = [square(40) for _ in range(50)]
print({solved(np.eye(30), np.ones(30)) for _ in range(2000)})
print(all((each == 3.0).all() for each in kept))
"""


def run(folder, script, *before, **other):
    path = os.pathsep.join([str(PROJECT), os.environ.get("PYTHONPATH", "")])
    done = subprocess.run(
        [*before, sys.executable, str(folder / script)],
        env={**os.environ, "PYTHONPATH": path, "NUMBA_DISABLE_JIT": "0", **other},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.strip(), done.stderr


def write(folder, factor, before=""):
    (folder / "part.py").write_text(PART.format(factor=factor), encoding="utf-8")
    (folder / "through.py").write_text(THROUGH, encoding="utf-8")
    (folder / "kernel.py").write_text(before + KERNEL, encoding="utf-8")


def test_kernel_is_recompiled_when_a_kernel_that_it_calls_changes(tmp_path):
    write(tmp_path, 2.0)
    first = run(tmp_path, "kernel.py")
    again = run(tmp_path, "kernel.py")
    (tmp_path / "part.py").write_text(PART.format(factor=30.0), encoding="utf-8")
    changed = run(tmp_path, "kernel.py")
    assert (first[0], again[0], changed[0]) == ("4.0 1 1", "4.0 1 0", "60.0 1 1")
    assert "once on this machine" in first[1]
    assert again[1] == ""


def test_kernel_compiles_if_no_folder_is_writable(tmp_path):
    write(tmp_path, 2.0, NOWHERE)
    printed, said = run(tmp_path, "kernel.py")
    assert printed == "4.0 1 1"
    assert "at each start; to store them, set NUMBA_CACHE_DIR" in said
    assert "once" not in said


READS = "-all,+dac_read_search"  # the interpreter may be in another user's folder
AS_NOBODY = (
    *("setpriv", "--reuid=65534", "--regid=65534", "--clear-groups"),
    *(f"--inh-caps={READS}", f"--ambient-caps={READS}"),
)
READ_ONLY = "unshare", "--mount", "sh", "-c", 'mount --bind -r "$0" "$0" && exec "$@"'


@pytest.fixture(scope="module")
def compiled_once(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("kernels")
    write(folder, 2.0)
    assert run(folder, "kernel.py")[0] == "4.0 1 1"
    return folder


@pytest.fixture
def installed(compiled_once) -> Iterator[Path]:
    """Compiled kernels, copied so that every user may read them, as in a container image."""
    folder = Path(tempfile.mkdtemp(prefix="dbb-kernels-"))  # pytest's folder is private
    shutil.copytree(compiled_once, folder, copy_function=shutil.copyfile, dirs_exist_ok=True)
    folder.chmod(0o755)
    yield folder
    shutil.rmtree(folder)


def prefix(kind: str, folder: Path) -> list[str]:
    """The words before a command that make it a reader `kind` of a folder, such as another user."""
    if kind == "another process":
        return []
    before = AS_NOBODY if kind == "another user" else (*READ_ONLY, str(folder))
    tried = [*before, sys.executable, "-c", ""]
    if os.getuid() or not shutil.which(before[0]) or subprocess.run(tried).returncode:
        pytest.skip("needs root on Linux")
    return list(before)


@pytest.mark.parametrize("kind", ["another process", "another user", "a read-only file system"])
def test_readable_cache_needs_no_compilation(installed, kind, tmp_path):
    nothing_else = {"HOME": str(tmp_path), "XDG_CACHE_HOME": "", "PYTHONDONTWRITEBYTECODE": "1"}
    printed, said = run(installed, "kernel.py", *prefix(kind, installed), **nothing_else)
    assert (printed, said) == ("4.0 1 0", "")


@pytest.mark.parametrize("kind", ["another user", "a read-only file system"])
def test_changed_kernels_are_cached_elsewhere_if_the_folder_is_read_only(installed, kind, tmp_path):
    (installed / "part.py").write_text(PART.format(factor=30.0), encoding="utf-8")
    no_home = {"HOME": "/nonexistent", "XDG_CACHE_HOME": "", "TMPDIR": str(tmp_path)}
    for folder in (tmp_path, *tmp_path.parents[:2]):
        folder.chmod(0o777)
    runs = [run(installed, "kernel.py", *prefix(kind, installed), **no_home) for _ in range(2)]
    assert [printed for printed, _ in runs] == ["60.0 1 1", "60.0 1 0"]


@pytest.mark.parametrize("ending", ["nbi", "nbc"])
def test_damaged_cache_file_is_replaced(installed, ending):
    (path,) = (installed / "__pycache__").glob(f"*.{ending}")
    path.write_bytes(path.read_bytes()[:9])
    assert [run(installed, "kernel.py")[0] for _ in range(2)] == ["4.0 1 1", "4.0 1 0"]


def test_cache_folder_writable_by_other_users_is_not_used(tmp_path, monkeypatch):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    own = tmp_path / f"dbb-{os.getuid()}"
    folders = system.cache_folders()
    assert next(folders) != own
    assert not own.exists(), "the first folder suffices so far"
    assert own not in system.cache_folders(make=False)
    assert not own.exists(), "a reader must create no folder"
    assert own in folders
    assert stat.S_IMODE(own.stat().st_mode) == 0o700
    own.chmod(0o777)
    assert own not in system.cache_folders()
    own.rmdir()
    own.symlink_to(tmp_path)
    assert own not in system.cache_folders()


@pytest.mark.parametrize("disabled", ["0", "1"])
def test_measurement_is_checked_with_and_without_compiled_kernels(tmp_path, disabled):
    (tmp_path / "checked.py").write_text(CHECKED, encoding="utf-8")
    kinds, refused = run(tmp_path, "checked.py", NUMBA_DISABLE_JIT=disabled)[0].splitlines()
    assert kinds == "{'float64'}"
    assert refused.startswith("measurement.base_pose must be 3 numbers")


def test_arrays_keep_their_values_after_later_calls_and_are_released(tmp_path):
    (tmp_path / "memory.py").write_text(MEMORY, encoding="utf-8")
    assert run(tmp_path, "memory.py")[0].split() == ["True", "True"]


def test_other_compiled_code_of_the_process_keeps_its_own_memory_management(tmp_path):
    (tmp_path / "beside.py").write_text(BESIDE, encoding="utf-8")
    assert run(tmp_path, "beside.py")[0].split() == ["{30.0}", "True"]
