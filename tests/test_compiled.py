"""Kernels are kept for as long as nothing that they are made of changes, and where they can be."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

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
from numba.core import caching
caching.CacheImpl._locator_classes = []  # as where neither program nor home can be written
"""

CHECKED = """
from types import SimpleNamespace
import numpy as np
from app.errors import MeasurementError
from app.robot.state import Measurement, checked

two = SimpleNamespace(n_b=2, n_m=2, n_d=0)
taken = checked(Measurement([0, 0, 0], [0, 0], [0, 0], np.zeros(2, "f4")), two)
print({each.dtype.name for each in taken[:4]})
try:
    checked(Measurement(np.zeros((3, 1)), *np.zeros((3, 2))), two)
except MeasurementError as error:
    print(error)
"""


def run(folder, script, **other):
    path = os.pathsep.join([str(PROJECT), os.environ.get("PYTHONPATH", "")])
    done = subprocess.run(
        [sys.executable, str(folder / script)],
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


def test_a_kernel_is_compiled_anew_when_one_that_it_calls_changes(tmp_path):
    write(tmp_path, 2.0)
    first = run(tmp_path, "kernel.py")
    again = run(tmp_path, "kernel.py")
    (tmp_path / "part.py").write_text(PART.format(factor=30.0), encoding="utf-8")
    changed = run(tmp_path, "kernel.py")
    assert (first[0], again[0], changed[0]) == ("4.0 1 1", "4.0 1 0", "60.0 1 1")
    assert "once on this machine" in first[1]
    assert again[1] == ""


def test_where_no_kernel_can_be_kept_it_is_compiled_all_the_same(tmp_path):
    write(tmp_path, 2.0, NOWHERE)
    printed, said = run(tmp_path, "kernel.py")
    assert printed == "4.0 1 1"
    assert "each time: set NUMBA_CACHE_DIR" in said
    assert "once" not in said


@pytest.mark.parametrize("disabled", ["0", "1"])
def test_a_measurement_is_checked_with_and_without_compiled_kernels(tmp_path, disabled):
    (tmp_path / "checked.py").write_text(CHECKED, encoding="utf-8")
    kinds, refused = run(tmp_path, "checked.py", NUMBA_DISABLE_JIT=disabled)[0].splitlines()
    assert kinds == "{'float64'}"
    assert refused.startswith("measurement.base_pose must be 3 numbers")
