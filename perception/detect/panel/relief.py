"""Round reliefs that protrude a few millimetres from a face: discs of raised points, best first."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Complex, Float
from scipy.fft import fft2, ifft2, next_fast_len

from costs.stopping import poll

_MOST_DISCS = 20
_CELL = 0.004
_RADII = np.arange(0.008, 0.061, 0.004)
_LEAST_HEIGHT = 0.005
_FEWEST = 4
_COLLAR = 0.008
_MOST = 600
_MIDDLE = 0.6  # of a disc's radius


@dataclass(frozen=True)
class Disc:
    """Raised disc on a face.

    Attributes:
        centre: (2,) x and y in the face's frame [m].
        height: mean height of its points [m].
        gain: log likelihood ratio of the disc against the bare face.
        roundness: smaller over larger standard deviation of its raised points, 0 to 1.
        around: mean height of the points in a ring around it, over its own.
        front: mean height of the points in its middle: those at its edge lie lower [m].
    """

    centre: Float[np.ndarray, "2"]
    radius: float
    height: float
    gain: float
    n_points: int
    roundness: float
    around: float
    front: float


def find_discs(
    points: Float[np.ndarray, "N 3"],
    low: Float[np.ndarray, "2"],
    high: Float[np.ndarray, "2"],
    sigma: float,
    least_gain: float,
) -> list[Disc]:
    """Return raised discs of a face, best first; each is sought without the points of the discs before.

    Args:
        points: (N, 3) in the face's frame [m].
        low, high: (2,) corners of the face [m].
    """
    discs: list[Disc] = []
    left, kernels = points, _kernels(low, high)
    while len(discs) < _MOST_DISCS:
        disc = _best(left, kernels, low, high, sigma)
        if disc is None or disc.gain < least_gain:
            break
        discs.append(disc)
        left = left[np.linalg.norm(left[:, :2] - disc.centre, axis=1) > disc.radius + _COLLAR]
    return discs


@dataclass(frozen=True)
class _Kernels:
    """Spectra of the discs, to sum over them by convolution on a face's grid.

    Attributes:
        shape: cells of the face's grid.
        padded: shape of the Fourier transforms.
        spectra: transform of the disc of each radius, centred on cell (0, 0).
    """

    shape: tuple[int, int]
    padded: tuple[int, int]
    radii: tuple[float, ...]
    spectra: tuple[Complex[np.ndarray, "A B"], ...]


def _kernels(low: Float[np.ndarray, "2"], high: Float[np.ndarray, "2"]) -> _Kernels:
    """Return the spectra of the discs of all radii that fit into a face."""
    radii = [float(radius) for radius in _RADII if 2.0 * radius <= 0.8 * (high - low).min()]
    rows, columns = (int(n) for n in np.ceil((high - low) / _CELL).astype(int) + 1)
    reach = int(np.ceil(max(radii, default=0.0) / _CELL))
    padded = (next_fast_len(rows + reach), next_fast_len(columns + reach))
    spectra = []
    for radius in radii:
        offset = [_CELL * np.minimum(np.arange(n), n - np.arange(n)) for n in padded]
        spectra.append(fft2((np.hypot(offset[0][:, None], offset[1][None, :]) <= radius).astype(float)))
    return _Kernels((rows, columns), padded, tuple(radii), tuple(spectra))


def _best(
    points: Float[np.ndarray, "N 3"],
    kernels: _Kernels,
    low: Float[np.ndarray, "2"],
    high: Float[np.ndarray, "2"],
    sigma: float,
) -> Disc | None:
    """Return the disc of greatest gain, ``(sum of heights)^2 / (2 n sigma^2)``, over all centres and radii."""
    poll()
    shape = kernels.shape
    cell = np.floor((points[:, :2] - low) / _CELL).astype(int)
    inside = ((cell >= 0) & (cell < shape)).all(axis=1)
    if inside.sum() < _FEWEST:
        return None
    flat = np.ravel_multi_index(tuple(cell[inside].T), shape)
    counts, sums = (
        np.bincount(flat, weight, minlength=shape[0] * shape[1]).reshape(shape)
        for weight in (np.ones(int(inside.sum())), points[inside, 2])
    )
    # The discs are real, so one complex transform carries counts and sums.
    both = fft2(counts + 1j * sums, s=kernels.padded)
    best: tuple[float, Float[np.ndarray, "2"], float] | None = None
    for radius, spectrum in zip(kernels.radii, kernels.spectra, strict=True):
        summed = ifft2(both * spectrum)[: shape[0], : shape[1]]
        n, total = np.round(summed.real), summed.imag
        valid = (n >= _FEWEST) & (total > _LEAST_HEIGHT * n)
        gain = np.where(valid, total**2 / (2.0 * np.maximum(n, 1.0) * sigma**2), 0.0)
        margin = int(0.7 * radius / _CELL)
        gain[:margin], gain[-margin or None :], gain[:, :margin], gain[:, -margin or None :] = 0.0, 0.0, 0.0, 0.0
        at = np.unravel_index(int(np.argmax(gain)), gain.shape)
        if gain[at] > 0.0 and (best is None or gain[at] > best[0]):
            best = (float(gain[at]), low + (np.array(at) + 0.5) * _CELL, float(radius))
    if best is None:
        return None
    return _measure(points, *_sharpen(points, best[1], best[2]), best[0])


def _sharpen(
    points: Float[np.ndarray, "N 3"], centre: Float[np.ndarray, "2"], radius: float
) -> tuple[Float[np.ndarray, "2"], float]:
    """Return centre and radius [m] of the disc of greatest gain within 4 mm of these.

    The mean of the raised points would be biased to the dense part of the scan.
    """
    near = points[np.linalg.norm(points[:, :2] - centre, axis=1) < radius + 2.0 * _CELL + 0.004]
    near = near[:: max(1, len(near) // _MOST)]
    step = np.linspace(-_CELL, _CELL, 5)
    x, y, wider = (grid.ravel() for grid in np.meshgrid(step, step, step))
    square = (near[:, 0, None] - centre[0] - x) ** 2 + (near[:, 1, None] - centre[1] - y) ** 2
    inside = square < (radius + wider) ** 2
    gain = (near[:, 2] @ inside) ** 2 / np.maximum(inside.sum(axis=0), 1)
    best = int(np.argmax(gain))
    return centre + np.array([x[best], y[best]]), radius + float(wider[best])


def _measure(points: Float[np.ndarray, "N 3"], centre: Float[np.ndarray, "2"], radius: float, gain: float) -> Disc:
    """Return the disc with its mean height, roundness and the height around it."""
    poll()
    apart = np.linalg.norm(points[:, :2] - centre, axis=1)
    mine = apart < radius
    height = float(np.mean(points[mine, 2])) if mine.any() else 0.0
    raised = (apart < radius + 0.02) & (points[:, 2] > 0.5 * height)
    roundness = 0.0
    if raised.sum() >= _FEWEST:
        values = np.linalg.eigvalsh(np.cov(points[raised, :2].T))
        roundness = float(np.sqrt(max(values[0], 0.0) / max(values[1], 1e-12)))
    ring = (apart > radius + _COLLAR) & (apart < radius + 0.022)
    around = float(points[ring, 2].mean()) / max(height, 1e-3) if ring.any() else 0.0
    middle = apart < _MIDDLE * radius
    front = float(np.mean(points[middle, 2])) if middle.sum() >= _FEWEST else height
    return Disc(centre, radius, height, gain, int(mine.sum()), roundness, around, front)
