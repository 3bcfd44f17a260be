"""Validated, frozen records shared by descriptions and configuration."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from pydantic import AllowInfNan, BaseModel, ConfigDict, Field, ValidationError

from app.errors import did_you_mean

Finite = Annotated[float, AllowInfNan(False)]
Positive = Annotated[float, AllowInfNan(False), Field(gt=0)]
NonNegative = Annotated[float, AllowInfNan(False), Field(ge=0)]
Vector3 = tuple[Finite, Finite, Finite]


class Strict(BaseModel):
    """A frozen record that refuses fields it does not know; field docstrings are its help."""

    model_config = ConfigDict(
        frozen=True, extra="forbid", use_attribute_docstrings=True, arbitrary_types_allowed=False
    )


def explain(error: ValidationError, model: type[BaseModel]) -> str:
    """All of a validation error, one `field: what would be right` a problem, on one line."""
    problems = []
    for problem in error.errors():
        path = _path(problem["loc"])
        if problem["type"] == "missing":
            problems.append(f"{path}: missing")
        elif problem["type"] == "extra_forbidden":
            names = _siblings(model, problem["loc"])
            hint = did_you_mean(str(problem["loc"][-1]), names)
            problems.append(f"{path}: unknown field{hint}; known: {', '.join(sorted(names))}")
        else:
            problems.append(f"{path}: {problem['msg']} (was {_short(problem['input'])})")
    return "; ".join(problems)


def _path(loc: tuple[int | str, ...]) -> str:
    text = ""
    for part in loc:
        text += f"[{part}]" if isinstance(part, int) else f".{part}" if text else part
    return text or "(whole file)"


def _short(value: object) -> str:
    text = repr(value.tolist() if isinstance(value, np.ndarray) else value)
    return text if len(text) <= 60 else text[:57] + "…"


def _siblings(model: type[BaseModel], loc: tuple[int | str, ...]) -> list[str]:
    """Field names of the record in which the last part of `loc` stands."""
    candidates: list[type[BaseModel]] = [model]
    for part in loc[:-1]:
        annotations = [
            c.model_fields[part].annotation for c in candidates if part in c.model_fields
        ]
        if annotations:
            candidates = [r for a in annotations for r in _records_in(a)]
        elif isinstance(part, str):  # the tag of a union: keep the record that carries it
            tagged = [c for c in candidates if part in _tags(c)]
            candidates = tagged or candidates
    return sorted({name for c in candidates for name in c.model_fields})


def _tags(model: type[BaseModel]) -> tuple[object, ...]:
    field = model.model_fields.get("type")
    return getattr(field.annotation, "__args__", ()) if field else ()


def _records_in(annotation: object) -> list[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [r for a in getattr(annotation, "__args__", ()) for r in _records_in(a)]
