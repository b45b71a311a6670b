"""Binds every command to its name; commands load their heavy libraries when they run."""

from __future__ import annotations

from dualarm_cli.cli.app import app

__all__ = ["app"]
