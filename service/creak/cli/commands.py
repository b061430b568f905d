"""The commands by name: each is imported when it is called, so that none waits for what the others need."""

from importlib import import_module
from typing import Any

import typer
from typer.core import TyperCommand, TyperGroup

_COMMANDS = {
    "demo": (
        "service",
        "Run the flexible-beam rig, live, until Ctrl-C: "
        "after some healthy realisations a spring appears at node 3.",
    ),
    "serve": ("service", "Run the service: rigs, store, API, recordings."),
    "worker": (
        "fleet",
        "Measure the rigs at this machine: cut periods, record, and send sums to the fleet's analysers.",
    ),
    "analyse": (
        "fleet",
        "Analyse what the fleet's workers send: one of any number of processes that share the rigs.",
    ),
    "simulate": ("recordings", "Make a recording from a model."),
    "import": (
        "recordings",
        "Make a recording from measured data, or from CAN logs (BLF, ASC, TRC, candump, MF4).",
    ),
    "replay": (
        "recordings",
        "Put a recording through the same pipeline as live data: the same numbers come out.",
    ),
    "export": ("export", "Write the samples of a recording for other programs, as `creak import` reads them."),
    "bench": (
        "bench",
        "Measure: tables of figures, each a ratio or a rate; options after the name are the benchmark's own.",
    ),
    "paper": (
        "paper",
        "Run the paper's two studies: three masses and a flexible beam, with its figures and a table of levels.",
    ),
    "excitation": ("excitation", "Write the multisines that a rig's generator is to play."),
    "configuration": (
        "configuration",
        "List every key of a service file: its variable, what is allowed, its default, what it means.",
    ),
    "rig": (
        "rig",
        "Play a rig's controller: simulate the rig and send its samples on the CAN interface of its source.",
    ),
    "diagnose": (
        "diagnose",
        "Find where a recording departs from a model, which effect causes it, and how far the gap shrinks.",
    ),
    "model": (
        "reference",
        "Take a healthy recording as the model, so that `diagnose` says what has changed since.",
    ),
    "key": ("keys", "Keys of the API, needed as soon as it listens beyond loopback."),
}
"""Module of every command, and the first paragraph of its help."""


def loaded(name: str) -> Any:
    """Import a command, or a group of them, by its name."""
    app = typer.Typer()
    import_module(f"creak.cli.{_COMMANDS[name][0]}").add_to(app)
    return typer.main.get_group(app).commands[name]


class Commands(TyperGroup):
    """Lists all commands, and imports the one that is called."""

    def __init__(self, **given: Any) -> None:
        super().__init__(**given)
        self.commands = {name: TyperCommand(name, help=text) for name, (_, text) in _COMMANDS.items()}

    def resolve_command(self, ctx: Any, args: list[str]) -> tuple[str | None, Any, list[str]]:
        """Find the command that is called, itself and not what stands for it in the list."""
        name, command, rest = super().resolve_command(ctx, args)
        return name, command if name is None else loaded(name), rest
