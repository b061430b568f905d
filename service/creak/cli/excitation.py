"""The command that writes multisines for a rig's own generator."""

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import IO, Annotated, Any, Literal

import numpy as np
import typer
from rich.console import Console

from creak.cli.recordings import RigFile, check_numbers, whole_file
from creak.config.rig import load_rig
from creak.config.spectrum import load_spectrum
from creak.crest import crest_factor
from creak.errors import InputError
from creak.multisine import Design, realisation
from creak.records import Real, Rig

_CREST_ITERATIONS = 100


def add_to(app: typer.Typer) -> None:
    """Register the command."""
    app.command()(excitation)


def excitation(
    *,
    rig: RigFile,
    output: Annotated[Path, typer.Option("--output", "-o", help="File to write: .npz, .mat or .csv.")],
    realisations: Annotated[int, typer.Option(help="Realisations, of as many experiments as inputs.")] = 10,
    rms: Annotated[float, typer.Option(help="RMS value of every input, in its unit.")] = 1.0,
    seed: Annotated[int, typer.Option(help="Seed of the random phases; simulate plays the same for it.")] = 1,
    periods: Annotated[int, typer.Option(help="Times that each experiment's period stands in the file.")] = 1,
    orthogonal: Annotated[
        Literal["rotation", "random"],
        typer.Option(help="rotation: as in the paper; random: experiments with independent distortions."),
    ] = "rotation",
    crest: Annotated[bool, typer.Option("--crest", help="Choose phases of a low crest factor.")] = False,
    spectrum: Annotated[
        Path | None, typer.Option(help="CSV of the amplitudes wanted: frequency_hz, and amplitude or node names.")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON document.")] = False,
) -> None:
    """Write the multisines that a rig's generator is to play.

    The file holds one period of each experiment (or ``--periods``): play it without a gap at least as often as the
    rig has transient periods and steady ones. Variable ``u`` has the axes experiment, input, sample.

    Example: `creak excitation --rig rig.toml --realisations 10 --rms 50 --seed 1 --output multisines.npz`
    """
    check_numbers(rms, seed, {"realisations": realisations, "periods": periods})
    write = _WRITERS.get(output.suffix.lower())
    if write is None:
        raise InputError(f"--output: {output}: should end in one of {', '.join(_WRITERS)}")
    measured = load_rig(rig)
    design = Design(
        orthogonal=orthogonal,
        amplitudes=None if spectrum is None else load_spectrum(spectrum, measured),
        crest_iterations=_CREST_ITERATIONS if crest else 0,
    )
    one = np.concatenate([realisation(measured, rms, seed, m, design) for m in range(realisations)])
    u = np.tile(one, periods)
    about = {
        "sample_rate": measured.sample_rate,
        "period_samples": measured.period_samples,
        "lines": np.asarray(measured.lines),
        "inputs": np.asarray([measured.nodes[i].name for i in measured.driven]),
        "rms": rms,
        "seed": seed,
    }
    with whole_file(output) as unfinished, unfinished.open("wb") as file:
        write(file, u, about, measured)
    document = _document(output, measured, one, periods, orthogonal)
    if as_json:
        typer.echo(json.dumps(document, indent=1, allow_nan=False))
        return
    lowest, highest = document["crest_factor"]["lowest"], document["crest_factor"]["highest"]
    Console().print(
        f"{output}: {document['experiments']} experiments of {document['inputs']} inputs and {u.shape[-1]} "
        f"samples, {len(measured.lines)} lines, {rms:g} rms; crest factor {lowest:.2f} to {highest:.2f}",
        highlight=False,
        soft_wrap=True,
    )
    if crest:
        Console(stderr=True).print(
            "creak: samples of a low crest factor are not spread like a Gaussian; the best linear approximation "
            "and the distortion depend on that spread, so compare only measurements made alike",
            style="yellow",
            highlight=False,
            soft_wrap=True,
        )


def _document(output: Path, rig: Rig, u: Real, periods: int, orthogonal: str) -> dict[str, Any]:
    factors = crest_factor(u)  # (experiment, input)
    return {
        "output": str(output),
        "rig": rig.name,
        "experiments": u.shape[0],
        "inputs": u.shape[1],
        "samples": u.shape[2] * periods,
        "periods": periods,
        "lines": len(rig.lines),
        "orthogonal": orthogonal,
        "peak": float(np.abs(u).max()),
        "crest_factor": {
            "lowest": float(factors.min()),
            "highest": float(factors.max()),
            "mean": float(factors.mean()),
        },
    }


_About = Mapping[str, Any]


def _write_npz(file: IO[bytes], u: Real, about: _About, _rig: Rig) -> None:
    np.savez(file, u=u, **about)


def _write_mat(file: IO[bytes], u: Real, about: _About, _rig: Rig) -> None:
    import scipy.io

    names = np.array(about["inputs"].tolist(), dtype=object)
    scipy.io.savemat(file, {"u": u, **about, "inputs": names}, do_compression=True)


def _write_csv(file: IO[bytes], u: Real, about: _About, rig: Rig) -> None:
    """All experiments below each other, told apart by their first column, counted from 0."""
    samples = u.shape[-1]
    columns = ["experiment", "time", *(f"u:{name}" for name in about["inputs"])]
    file.write((",".join(columns) + "\n").encode())
    time = np.arange(samples) / rig.sample_rate
    for e, inputs in enumerate(u):
        table = np.column_stack([np.full(samples, e), time, *inputs])
        np.savetxt(file, table, delimiter=",", fmt=["%d", *["%.17g"] * (len(columns) - 1)])


_WRITERS: dict[str, Callable[[IO[bytes], Real, _About, Rig], None]] = {
    ".npz": _write_npz,
    ".mat": _write_mat,
    ".csv": _write_csv,
}
