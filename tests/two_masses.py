"""Two masses on a chain as files of rig and model."""


def rig(name="small", *, rate=1024.0, samples=256, transient=2, band=(4.0, 200.0)):
    """Text of a rig file: both masses driven and measured."""
    nodes = "".join(f'[[nodes]]\nname = "{node}"\ninput = "N"\noutput = "m"\n' for node in "12")
    return (
        f'name = "{name}"\nsample_rate = {rate}\nperiod_samples = {samples}\n'
        f"transient_periods = {transient}\nband = {list(band)}\n{nodes}"
    )


def model(damping=60.0, cubic=None):
    """Text of a model file: ground - 1 - 2, with a cubic spring from 2 to the ground if it has a coefficient."""
    text = (
        'kind = "lumped"\n'
        'masses = [{name = "1", mass = 1.0}, {name = "2", mass = 1.0}]\n'
        f'links = [{{between = ["ground", "1"], stiffness = 1e4, damping = {damping}}},\n'
        f'         {{between = ["1", "2"], stiffness = 2e4, damping = {damping}}}]\n'
    )
    if cubic is not None:
        text += f'[[effects]]\neffect = "cubic_stiffness"\nat = ["2", "ground"]\ncoefficient = {cubic}\n'
    return text
