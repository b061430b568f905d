"""A rig of two masses, small enough to be diagnosed in seconds, with a cubic spring that its model lacks."""

RIG = """
name = "small"
sample_rate = 1024.0
period_samples = 1024
transient_periods = 3
band = [4.0, 80.0]
[[nodes]]
name = "1"
input = "N"
output = "m"
[[nodes]]
name = "2"
input = "N"
output = "m"
"""
MODEL = """
kind = "lumped"
[[masses]]
name = "1"
mass = 1.0
[[masses]]
name = "2"
mass = 1.2
[[links]]
between = ["ground", "1"]
stiffness = 1e4
damping = 15.0
[[links]]
between = ["1", "2"]
stiffness = 2e4
damping = 15.0
[[links]]
between = ["2", "ground"]
stiffness = 1e4
damping = 15.0
"""
COEFFICIENT = 3e7
CUBIC = f'{MODEL}[[effects]]\neffect = "cubic_stiffness"\nat = ["2", "ground"]\ncoefficient = {COEFFICIENT}\n'


def write(directory):
    """Write rig, model and truth into a directory."""
    (directory / "rig.toml").write_text(RIG)
    (directory / "model.toml").write_text(MODEL)
    (directory / "truth.toml").write_text(CUBIC)


def simulate(output, model="truth.toml", realisations=5, rms=20, seed=1, snr=40):
    """Words of the command that makes a recording."""
    words = ["simulate", "--model", model, "--rig", "rig.toml", "--realisations", realisations, "--rms", rms]
    return [str(word) for word in (*words, "--snr-db", snr, "--seed", seed, "--output", output)]
