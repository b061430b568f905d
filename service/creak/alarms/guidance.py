"""What an operator is told to do, a text for each condition."""

GUIDANCE = {
    "level": (
        "The nonlinear distortion of this node is significant and above its limit. Look at the spectrum and the "
        "elements of the node, then inspect there for looseness, rubbing, cracks and worn bearings."
    ),
    "baseline": (
        "The node has changed against what was learnt when it was healthy. Inspect it; if the machine was changed "
        "on purpose, have a new baseline learnt."
    ),
    "trend": (
        "The distortion of this node grows slowly. Nothing is urgent yet: plan an inspection and watch the trend."
    ),
    "silence": "No frame has come for a while. Check that the rig runs, its network and its power.",
    "lost_frames": (
        "Frames are lost or refused, and their realisations are left out. Check cabling, bus load and clock."
    ),
    "clipped_sensor": (
        "The sensor sits at a limit for many samples or does not move: it clips or is stuck. Check its range, its "
        "supply and its fixing; the levels of this node cannot be trusted."
    ),
    "too_few_realisations": (
        "Too few realisations are complete for a level to be tested. Look at the faults of the run."
    ),
    "transient_not_settled": (
        "The response still settles when the first steady period begins, which swells the noise and hides "
        "distortion. Raise transient_periods of the rig."
    ),
    "stale_estimate": "No realisation has become complete for a while, so the levels shown are old.",
}
"""Text by condition."""


def guidance(condition: str) -> str:
    """Text for a condition, or for several joined by ``+``; empty for one that is not known."""
    return " ".join(GUIDANCE[name] for name in condition.split("+") if name in GUIDANCE)
