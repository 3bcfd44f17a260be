"""Widgets: assignments that send only what has changed."""

from __future__ import annotations

from app.dashboard.job import Progress


def renew(handle: object, name: str, value: object) -> None:
    """Assign a property of a widget; what has not changed is not sent."""
    if getattr(handle, name) != value:
        setattr(handle, name, value)


def renew_bar(bar: object, progress: Progress | None) -> None:
    """Show how far something is, if anybody knows."""
    known = progress is not None and progress.share >= 0.0
    renew(bar, "visible", known)
    if progress is not None and known:
        renew(bar, "value", round(100.0 * progress.share, 1))
