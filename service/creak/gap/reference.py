"""A recording as the model: the response matrix of a healthy structure, and what it leaves open."""

from dataclasses import replace

import numpy as np

from creak.errors import MeasurementError
from creak.gap.periodic import PeriodicData
from creak.mechanics.response import Response
from creak.mechanics.structure import MeasuredResponse
from creak.mechanics.system import Model
from creak.records import Complex, Real, Rig

_BETWEEN = 0.03  # share of the response by which an interpolated line may be wrong
_BEYOND = 0.3  # and one beyond the measured band
_LOCAL = 11  # neighbouring lines whose responses make one where a single realisation tells no error
_POOLED = 9  # neighbouring lines over which the distortion of the structure itself is taken


def measure(rig: Rig, data: PeriodicData) -> Response:
    """Estimate the response matrix of a recording, ``S = sum Y U^H (sum U U^H)^-1``, with its covariance.

    Parameters
    ----------
    rig : Rig
    data : PeriodicData

    Returns
    -------
    Response

    Raises
    ------
    MeasurementError
        If the experiments do not tell the inputs apart.
    """
    lines = list(rig.lines)
    U = np.fft.rfft(data.u, axis=-1)[..., lines].transpose(2, 0, 1) / rig.period_samples  # (F, E, q)
    Y = data.Y[:, lines].transpose(1, 0, 2)
    gram = U.transpose(0, 2, 1) @ U.conj()
    power = np.trace(gram, axis1=1, axis2=2).real
    weak = (power <= 0) | (np.linalg.cond(gram) > 1e8)
    if weak.any():
        raise MeasurementError(
            f"its experiments do not tell the inputs apart at line {lines[int(np.argmax(weak))]}, so it holds no "
            "response matrix"
        )
    leverage = np.linalg.inv(gram).astype(np.complex128)
    S = np.asarray(Y.transpose(0, 2, 1) @ U.conj() @ leverage, dtype=np.complex128)
    count, q = U.shape[1:]
    variance = np.mean(np.abs(data.Y) ** 2, axis=0)
    if count > q:
        rest = Y - U @ S.transpose(0, 2, 1)
        variance[lines] = np.sum(np.abs(rest) ** 2, axis=1) / (count - q)
    elif len(lines) > _LOCAL and np.all(np.diff(lines) == 1):
        S, variance[lines], share = _local(U, Y)
        leverage = leverage * share
    else:
        variance[lines] = data.variance[lines]
    distortion = np.zeros_like(variance)
    excited = np.zeros(len(variance), dtype=bool)
    excited[lines] = True
    for at in (excited, ~excited):
        distortion[at] = np.maximum(_smooth(variance[at] - data.variance[at]), 0.0)
    return Response(rig, S, data.variance + distortion, distortion, leverage)


def _local(U: Complex, Y: Complex) -> tuple[Complex, Real, float]:
    """Response of a single realisation: a parabola through neighbouring lines, so that something tells its error.

    Parameters
    ----------
    U : array, (F, E, q)
    Y : array, (F, E, n)

    Returns
    -------
    array, (F, n, q)
    array, (F, n)
        Variance about it.
    float
        Share of the variance of a single line's response that is left.
    """
    F, E, q = U.shape
    half = _LOCAL // 2
    S = np.empty((F, Y.shape[2], q), dtype=np.complex128)
    variance = np.empty((F, Y.shape[2]))
    for k in range(F):
        at = np.arange(_LOCAL) + min(max(k - half, 0), F - _LOCAL)
        t = (at - k) / half
        powers = np.stack([np.ones_like(t), t, t**2], axis=-1)
        terms = (powers[:, None, :, None] * U[at][:, :, None, :]).reshape(_LOCAL * E, 3 * q)
        wanted = Y[at].reshape(_LOCAL * E, -1)
        fitted = np.linalg.lstsq(terms, wanted, rcond=None)[0]
        S[k] = fitted[:q].T
        variance[k] = np.sum(np.abs(wanted - terms @ fitted) ** 2, axis=0) / (len(terms) - 3 * q)
    t = np.linspace(-1, 1, _LOCAL)
    powers = np.stack([np.ones_like(t), t, t**2], axis=-1)
    return S, variance, float(np.linalg.inv(powers.T @ powers)[0, 0])


def _smooth(values: Real) -> Real:
    """Mean over neighbouring lines, ``(L, n)``."""
    width = min(_POOLED, len(values) - 1 + len(values) % 2)
    if width < 3:
        return values
    padded = np.pad(values, ((width // 2, width // 2), (0, 0)), mode="reflect")
    total = np.cumsum(np.vstack([np.zeros((1, values.shape[1])), padded]), axis=0)
    return np.asarray((total[width:] - total[:-width]) / width)


def seen_by(model: Model, rig: Rig) -> Rig:
    """Rig as a model takes it: what the hold does is in a measured response already."""
    return replace(rig, hold="band-limited") if isinstance(model, MeasuredResponse) else rig


def widened(rig: Rig, model: Model, data: PeriodicData) -> PeriodicData:
    """Data whose variance holds what a model cannot know: a measured one has noise and distortion of its own.

    A model that is no recording knows all, and leaves them as they are. Otherwise the variance of an experiment
    grows by that of ``S U``, by the distortion which the structure had already, and by what interpolation between
    the measured lines and continuation beyond them may be wrong by.

    Parameters
    ----------
    rig : Rig
    model : Model
    data : PeriodicData
    """
    if not isinstance(model, MeasuredResponse) or model.response is None:
        return data
    response = model.response
    distortion = np.zeros_like(response.distortion) if model.linear else response.distortion
    known = list(response.rig.lines)
    U = np.fft.rfft(data.u, axis=-1)[..., known].transpose(2, 0, 1) / rig.period_samples
    own = np.einsum("fei,fij,fej->f", U.conj(), response.leverage, U).real / len(data.u)
    variance = data.variance + distortion
    variance[known] += own[:, None] * response.variance[known]
    doubt = np.full(len(variance), _BEYOND)
    doubt[known[0] : known[-1] + 1] = _BETWEEN
    doubt[known] = 0.0
    variance = variance + (doubt**2)[:, None] * np.mean(np.abs(data.Y) ** 2, axis=0)
    return replace(data, variance=variance)


def shared_errors(model: Model, data: PeriodicData, experiments: int) -> float:
    """Factor on standard errors, since all experiments share the errors of a measured model.

    A parameter whose effect is coherent with the inputs meets them as a bias, not as noise of each experiment: in
    the ``q`` coherent directions of a line, E experiments have E/q times the error of one.

    Parameters
    ----------
    model : Model
    data : PeriodicData
        As `widened` returned it.
    experiments : int
        That were fitted.
    """
    if not isinstance(model, MeasuredResponse) or model.response is None:
        return 1.0
    response = model.response
    lines = list(response.rig.lines)
    U = np.fft.rfft(data.u, axis=-1)[..., lines].transpose(2, 0, 1) / response.rig.period_samples
    own = np.einsum("fei,fij,fej->f", U.conj(), response.leverage, U).real / len(data.u)
    added = own[:, None] * response.variance[lines] / data.variance[lines]
    return float(np.sqrt(1 + np.median(added) * max(experiments / U.shape[-1] - 1, 0.0)))


def notes(model: Model) -> list[str]:
    """What a measured model leaves open, a sentence each; none for another one."""
    if not isinstance(model, MeasuredResponse) or model.response is None:
        return []
    rig = model.response.rig
    found = ["the model is the linear response in a recording, whose noise counts too"]
    if not model.linear:
        found = [
            "the model is a recording: the gap is what has changed since, and its noise counts that of the "
            "recording and the distortion that the structure had then",
        ]
    still = [node.name for node in rig.nodes if node.input is None]
    if still:
        found.append(f"what acts at {', '.join(still)} was not tested, since no input is there")
    return found
