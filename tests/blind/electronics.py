"""Amplifiers and sensors of the blind cases, on the samples of one period in steady state."""

import numba
import numpy as np


def shifted(samples, delay, fs):
    """Periodic samples, later by a time: every line turned back by its phase."""
    lines = np.fft.rfft(samples)
    frequency = np.arange(len(lines)) * fs / samples.size
    lines = lines * np.exp(-2j * np.pi * frequency * delay)
    if samples.size % 2 == 0:
        lines[-1] = lines[-1].real
    return np.fft.irfft(lines, n=samples.size)


@numba.njit(cache=True)
def slope(z, way, bound):
    """Rate of a Bouc-Wen memory along its path."""
    return 1.0 - 0.5 * (1.0 + np.sign(way * z)) * (z / bound) ** 2


@numba.njit(cache=True)
def bouc_wen(samples, bound, pieces=200, periods=8):
    """Memory along samples, integrated in small pieces of path (Heun's rule) until the loop has closed."""
    z = 0.0
    out = np.empty(samples.size)
    before = samples[-1]
    for _ in range(periods):
        for n in range(samples.size):
            way = (samples[n] - before) / pieces
            for _ in range(pieces):
                first = slope(z, way, bound)
                z += 0.5 * way * (first + slope(z + way * first, way, bound))
            before = samples[n]
            out[n] = z
    return out


def actuated(effect, values, samples, fs):
    """What an amplifier makes of its input."""
    match effect:
        case "actuator_gain":
            return values["gain"] * samples
        case "actuator_delay":
            return shifted(samples, values["delay"], fs)
        case "actuator_saturation":
            return np.minimum(np.maximum(samples, -values["limit"]), values["limit"])
        case "actuator_dead_zone":
            return np.sign(samples) * np.maximum(np.abs(samples) - values["width"], 0.0)
        case "actuator_hysteresis":
            share = values["share"]
            return (1 - share) * samples + share * bouc_wen(samples, values["yield_input"])
    raise KeyError(effect)


def sensed(effect, values, samples, fs):
    """What a sensor makes of its response."""
    match effect:
        case "sensor_gain":
            return values["gain"] * samples
        case "sensor_delay":
            return shifted(samples, values["delay"], fs)
        case "sensor_clipping":
            return np.minimum(np.maximum(samples, -values["limit"]), values["limit"])
        case "sensor_quantisation":
            return values["step"] * np.rint(samples / values["step"])
    raise KeyError(effect)
