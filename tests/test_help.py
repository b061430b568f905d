"""Every command says what it does with an example that it understands itself; shells can complete them all."""

import inspect
import os
import re
import shlex
import subprocess
import sys

import pytest
import typer

from creak.cli import app, run
from creak.cli.commands import loaded


def commands(known, words=()):
    """Every command with the words that call it, those of its groups before it."""
    for name, command in known.items():
        if hasattr(command, "commands"):
            yield from commands(command.commands, (*words, name))
        else:
            yield (*words, name), command


LISTED = typer.main.get_command(app).commands
ALL = list(commands({name: loaded(name) for name in LISTED}))


def examples(command):
    text = inspect.cleandoc(command.help or "")
    return [" ".join(found.split()) for found in re.findall(r"Example: `([^`]+)`", text)]


@pytest.mark.parametrize(("words", "command"), ALL, ids=[" ".join(words) for words, _ in ALL])
def test_every_command_has_an_example_that_it_understands(words, command):
    """Kills an example of an option that is called otherwise now, or of another command."""
    found = examples(command)
    assert found, "no example"
    for example in found:
        called, *arguments = shlex.split(example)
        assert (called, *arguments[: len(words)]) == ("creak", *words)
        context = command.make_context(" ".join(words), arguments[len(words) :])
        unknown = [word for word in context.args if word not in ("--json",)]  # bench hands options on
        assert unknown == []


@pytest.mark.parametrize("words", [(), *(words for words, _ in ALL), ("key",)], ids=" ".join)
def test_help_is_shown(words, capsys):
    assert run([*words, "--help"]) == 0
    assert "Usage" in capsys.readouterr().out


@pytest.mark.parametrize("name", LISTED)
def test_a_command_is_listed_with_the_first_paragraph_of_its_help(name):
    """Kills a list that is not kept when a command changes."""
    first = inspect.cleandoc(loaded(name).help).partition("\n\n")[0]
    assert LISTED[name].help == " ".join(first.split())


def test_the_list_is_shown_without_importing_what_the_commands_need():
    """Help and completion are there at once; numba and the server's libraries take more than a second."""
    program = (
        "import sys; from creak.cli import run; code = run(['--help'])\n"
        "sys.exit(code or sorted({'numpy', 'numba', 'scipy', 'fastapi', 'sqlalchemy'} & set(sys.modules)) or 0)"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert "diagnose" in done.stdout


@pytest.fixture
def complete(monkeypatch, capsys):
    """What a shell is told when the last of some words is to be completed."""

    def asked(*words):
        monkeypatch.setattr(sys, "argv", ["creak"])
        monkeypatch.setattr(sys.modules["__main__"], "__package__", "", raising=False)  # else: python -m pytest
        monkeypatch.setenv("_CREAK_COMPLETE", "complete_bash")
        monkeypatch.setenv("COMP_WORDS", " ".join(("creak", *words)))
        monkeypatch.setenv("COMP_CWORD", str(len(words)))
        with pytest.raises(SystemExit):
            run()
        return capsys.readouterr().out.split()

    return asked


def test_a_shell_completes_commands_and_options(complete):
    assert complete("ex") == ["export", "excitation"]
    assert "--save-model" in complete("diagnose", "--")
    assert complete("key", "") == ["add", "list", "remove"]


@pytest.mark.parametrize(
    ("wish", "shell", "said"),
    [
        ("--show-completion", "zsh", "_CREAK_COMPLETE"),
        ("--install-completion", "bash", "bash completion installed"),
    ],
)
def test_a_shell_learns_to_complete(wish, shell, said, tmp_path):
    """The real process: it writes into the home of whoever runs it."""
    environment = {**os.environ, "_TYPER_COMPLETE_TEST_DISABLE_SHELL_DETECTION": "1", "HOME": str(tmp_path)}
    program = "import sys; sys.argv[0] = 'creak'; from creak.cli import main; main()"
    done = subprocess.run(
        [sys.executable, "-c", program, wish, shell], env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert said in done.stdout
