"""What a figure is made of, and the files that it becomes."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from app.studies.style import png_of

Array = np.ndarray


@dataclass(frozen=True)
class Table:
    """Columns of equal length, as a figure plots them.

    Attributes:
        columns: By name; names of quantities end in their unit. Numbers, or names as text.
    """

    columns: dict[str, Array]

    def __getitem__(self, column: str) -> Array:
        return self.columns[column]

    def __len__(self) -> int:
        return len(next(iter(self.columns.values())))

    def write(self, path: Path) -> None:
        """Write it as CSV; numbers keep all their digits, NaN is an empty cell."""
        with path.open("w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file)
            writer.writerow(self.columns)
            writer.writerows(zip(*(map(_cell, c) for c in self.columns.values()), strict=True))


@dataclass(frozen=True)
class Drawing:
    """One figure of the paper, made anew.

    Attributes:
        title: Its number in the paper and what it shows.
        paper: What the paper says about it, in our words.
        figure: The picture.
        tables: What is plotted; the first without a suffix, the others by theirs.
        measured: Figures of it; keys end in their unit.
        remarks: What has to be said about the measured figures, one sentence each.
    """

    title: str
    paper: str
    figure: Figure
    tables: dict[str, Table]
    measured: dict[str, object] = field(default_factory=dict)
    remarks: Sequence[str] = ()

    def write(self, folder: Path, name: str) -> list[Path]:
        """Write PNG and CSVs into a folder; returns their paths, the PNG first."""
        picture = folder / f"{name}.png"
        self.figure.suptitle(self.title, x=0.01, ha="left", fontsize=13)
        picture.write_bytes(png_of(self.figure))
        paths = [picture]
        for suffix, table in self.tables.items():
            path = folder / (f"{name}_{suffix}.csv" if suffix else f"{name}.csv")
            table.write(path)
            paths.append(path)
        return paths


def stacked(parts: dict[str, dict[str, Array]], kind: str) -> Table:
    """One long table from several with the same columns, told apart by a column of their names.

    Args:
        parts: Columns of each part, by the part's name.
        kind: Name of the column that holds the parts' names.
    """
    names = np.concatenate([np.full(len(next(iter(p.values()))), n) for n, p in parts.items()])
    columns = next(iter(parts.values()))
    joined = {c: np.concatenate([part[c] for part in parts.values()]) for c in columns}
    return Table({kind: names, **joined})


def _cell(value: object) -> object:
    if isinstance(value, (float, np.floating)):
        return "" if np.isnan(value) else repr(float(value))
    return value.item() if isinstance(value, np.generic) else value
