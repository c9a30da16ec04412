"""The `nsdyn` command."""

from nsdyn.cli.command import main

__all__ = ["main"]
