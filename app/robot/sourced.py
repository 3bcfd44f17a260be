"""Records whose every number says where it comes from."""

from __future__ import annotations

from pydantic import Field, model_validator
from typing_extensions import Self

from app.strict import Strict


class Sourced(Strict):
    """A record in which every number that is stated must have a line in `source`."""

    source: dict[str, str] = Field(default_factory=dict)
    """Where each number comes from: one entry per numeric field, by the field's name."""

    @model_validator(mode="after")
    def _every_number_has_a_source(self) -> Self:
        stated = {
            name
            for name in self.model_fields_set
            if name != "source" and _holds_a_number(getattr(self, name))
        }
        if missing := stated - self.source.keys():
            raise ValueError(
                f"give the source of {', '.join(sorted(missing))} in the table `source`"
            )
        if unknown := self.source.keys() - type(self).model_fields.keys():
            raise ValueError(f"`source` names unknown fields: {', '.join(sorted(unknown))}")
        return self


def _holds_a_number(value: object) -> bool:
    if isinstance(value, tuple | list):
        return any(_holds_a_number(item) for item in value)
    return isinstance(value, int | float) and not isinstance(value, bool)
