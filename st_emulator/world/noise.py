"""Noise as a function of (seed, frame, pixel): counter-based, so any pixel can be made alone, in any order.

Each pixel of each frame owns one 64-bit word: SplitMix64's output function (Steele, Lea, Flood, "Fast
splittable pseudorandom number generators", OOPSLA 2014; Stafford's mix 13 constants) of a key of (seed,
stream, frame) and the pixel's number. The word gives one standard normal deviate by the inverse of the normal
distribution: linear interpolation in a table of 8192 equal steps of probability (error under 6e-4 sigma), and
the outer 1/1024 on each side from the 63 bits left by Wichura's formula (Algorithm AS 241, PPND16, Applied
Statistics 37 (1988)), so the tails are right to 9 sigma.

A pixel's charge is Poisson; read-out noise is Gaussian. Where the variance of their sum is large, the sum is
drawn in one step from its own Cornish-Fisher expansion (Abramowitz & Stegun 26.2.49, third and fourth
cumulant both equal to the mean); elsewhere, and near saturation, charge and read-out noise are drawn one
after the other, the charge by exact inversion of the Poisson distribution below a mean of 30.

All kernels are IEEE 754 arithmetic in a fixed order without contraction: a pixel comes out the same bits
whichever rectangle is rendered.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
U64 = NDArray[np.uint64]

_MASK = (1 << 64) - 1
_GOLDEN = np.uint64(0x9E3779B97F4A7C15)
_MIX_1 = np.uint64(0xBF58476D1CE4E5B9)
_MIX_2 = np.uint64(0x94D049BB133111EB)
_SECOND_DRAW = np.uint64(0xD1B54A32D192ED03)
_S11, _S27, _S30, _S31, _S32 = (np.uint64(n) for n in (11, 27, 30, 31, 32))
_LOW_63 = np.uint64((1 << 63) - 1)

# streams: words of different streams never meet
STREAM_FRAME = 1
STREAM_RESPONSE = 2
STREAM_DARK = 3
STREAM_HOT = 4
STREAM_HOT_AMOUNT = 5
STREAM_FALSE_SPOTS = 6

_STEPS = 4096  # table steps over the upper half of the distribution
_TAIL_STEP = _STEPS - 8  # from here on the formula: 1 in 512 deviates, beyond 3.1 sigma
POISSON_EXACT_BELOW = np.float32(30.0)
_ONE_DRAW_VARIANCE = np.float32(40.0)
_ONE_DRAW_READ_NOISE = 0.7  # electrons; below it, whole electrons would show between the lines


@njit(nogil=True, error_model="numpy")
def _mix(word: np.uint64) -> np.uint64:
    word = (word ^ (word >> _S30)) * _MIX_1
    word = (word ^ (word >> _S27)) * _MIX_2
    return word ^ (word >> _S31)


def stream_key(seed: int, stream: int, number: int = 0) -> np.uint64:
    """The key of a stream: ``word(pixel) = mix(key + pixel * golden)``. number: the frame index, or 0."""
    word = 0
    for part in (seed, stream, number):
        word = (word + int(_GOLDEN) + (part & _MASK)) & _MASK
        for shift, factor in ((30, int(_MIX_1)), (27, int(_MIX_2))):
            word = ((word ^ (word >> shift)) * factor) & _MASK
        word ^= word >> 31
    return np.uint64(word)


@njit(nogil=True, error_model="numpy")
def _upper_tail(p: float) -> float:
    """x with P(X > x) = p of the standard normal distribution, 0 < p < 0.075 (AS 241, PPND16, both outer
    regions)."""
    r = math.sqrt(-math.log(p))
    if r <= 5.0:
        r -= 1.6
        return (
            ((((((7.7454501427834140764e-4 * r + 2.27238449892691845833e-2) * r + 2.41780725177450611770e-1) *
            r + 1.27045825245236838258) * r + 3.64784832476320460504) * r + 5.76949722146069140550) * r +
            4.63033784615654529590) * r + 1.42343711074968357734
        ) / (
            ((((((1.05075007164441684324e-9 * r + 5.47593808499534494600e-4) * r + 1.51986665636164571966e-2)
            * r + 1.48103976427480074590e-1) * r + 6.89767334985100004550e-1) * r + 1.67638483018380384940) *
            r + 2.05319162663775882187) * r + 1.0
        )  # fmt: skip
    r -= 5.0
    return (
        ((((((2.01033439929228813265e-7 * r + 2.71155556874348757815e-5) * r + 1.24266094738807843860e-3) * r
        + 2.65321895265761230930e-2) * r + 2.96560571828504891230e-1) * r + 1.78482653991729133580) * r
        + 5.46378491116411436990) * r + 6.65790464350110377720
    ) / (
        ((((((2.04426310338993978564e-15 * r + 1.42151175831644588870e-7) * r + 1.84631831751005468180e-5) * r
        + 7.86869131145613259100e-4) * r + 1.48753612908506148525e-2) * r + 1.36929880922735805310e-1) * r
        + 5.99832206555887937690e-1) * r + 1.0
    )  # fmt: skip


def _central_table() -> F32:
    """Quantiles of the upper half in equal steps of probability; computed by bisection on erfc, so from no
    other formula."""
    steps = np.arange(_TAIL_STEP + 1)
    probability = 0.5 - 0.5 * steps / _STEPS  # upper tail
    low, high = np.zeros(steps.shape[0]), np.full(steps.shape[0], 9.0)
    for _ in range(60):
        middle = 0.5 * (low + high)
        above = np.array([0.5 * math.erfc(x / math.sqrt(2.0)) for x in middle]) > probability
        low, high = np.where(above, middle, low), np.where(above, high, middle)
    table = np.zeros(_STEPS + 1, dtype=np.float32)  # the tail's steps are read and then replaced
    table[: _TAIL_STEP + 1] = 0.5 * (low + high)
    table[0] = 0.0
    return table


NORMAL_TABLE: F32 = _central_table()


@njit(nogil=True, error_model="numpy")
def _normal(word: np.uint64, table: F32) -> np.float32:
    """One standard normal deviate from a word: bit 63 the sign, bits 32-62 the place in the half
    distribution."""
    top = np.int32(word >> _S32)
    place = top & np.int32(0x7FFFFFFF)
    step = place >> np.int32(19)
    if step >= _TAIL_STEP:
        left = np.float64(_LOW_63 - (word & _LOW_63)) + 0.5
        value = np.float32(_upper_tail(left * 2.0**-64))
    else:
        fraction = np.float32(place & np.int32(0x7FFFF)) * np.float32(2.0**-19)
        value = table[step] + (table[step + 1] - table[step]) * fraction
    return -value if top < 0 else value


@njit(nogil=True, error_model="numpy")
def words_of(key: np.uint64, first: int, words: U64) -> None:
    """words[i] = the word of pixel number first + i."""
    start = np.uint64(first)
    for i in range(words.shape[0]):
        words[i] = _mix(key + (start + np.uint64(i)) * _GOLDEN)


@njit(nogil=True, error_model="numpy")
def normals_of(words: U64, table: F32, deviates: F32) -> None:
    """deviates[i] = `_normal` (words[i]), the table's part in one loop without branches."""
    for i in range(words.shape[0]):
        top = np.int32(words[i] >> _S32)
        place = top & np.int32(0x7FFFFFFF)
        step = place >> np.int32(19)
        fraction = np.float32(place & np.int32(0x7FFFF)) * np.float32(2.0**-19)
        value = table[step] + (table[step + 1] - table[step]) * fraction
        deviates[i] = -value if top < 0 else value
    for i in range(words.shape[0]):
        if (np.int32(words[i] >> _S32) & np.int32(0x7FFFFFFF)) >> np.int32(19) >= _TAIL_STEP:
            deviates[i] = _normal(words[i], table)


@njit(nogil=True, error_model="numpy")
def _poisson(mean: np.float32, word: np.uint64, table: F32) -> np.float32:
    """A Poisson number: exact inversion below a mean of 30, else a rounded Cornish-Fisher expansion."""
    if mean < POISSON_EXACT_BELOW:
        u = (np.float64(word >> _S11) + 0.5) * 2.0**-53
        term = math.exp(-np.float64(mean))
        total = term
        count = 0
        while total < u and count < 300:
            count += 1
            term *= np.float64(mean) / count
            total += term
        return np.float32(count)
    z = np.float64(_normal(word, table))
    m = np.float64(mean)
    x = m + math.sqrt(m) * z + (z * z - 1.0) / 6.0 + z * (1.0 - z * z) / (72.0 * math.sqrt(m))
    return np.float32(math.floor(x + 0.5))


@njit(nogil=True, error_model="numpy")
def charge_of(mean: float, word: np.uint64, table: F32) -> float:
    """A word's Poisson number of a mean."""
    return float(_poisson(np.float32(mean), word, table))


@njit(nogil=True, error_model="numpy")
def digitise(
    mean: F32, words: U64, deviates: F32, table: F32, detector: F32, out: NDArray[np.uint16]
) -> None:
    """Mean charges of a run of pixels -> numbers put out.

    mean (electrons), words, deviates: [n]; detector: see `detector_constants`; out: uint16[n].
    """
    read_noise, variance_0, inverse_gain, offset, top, full_well, low, high = detector
    one, two, three, five = np.float32(1.0), np.float32(2.0), np.float32(3.0), np.float32(5.0)
    sixth, c24, c36 = np.float32(1.0 / 6.0), np.float32(1.0 / 24.0), np.float32(1.0 / 36.0)
    zero, half = np.float32(0.0), np.float32(0.5)
    slow = np.int64(0)
    for i in range(mean.shape[0]):
        m = mean[i]
        z = deviates[i]
        variance = m + variance_0
        sigma = np.float32(math.sqrt(variance))
        share = m / variance  # third cumulant over variance
        z2 = z * z
        x = (
            m
            + sigma * z
            + share * sixth * (z2 - one)
            + z * (share / sigma) * ((z2 - three) * c24 - share * (two * z2 - five) * c36)
        )
        number = x * inverse_gain + (offset + half)
        number = min(max(number, zero), top)
        out[i] = np.uint16(np.int32(number))
        slow += np.int64((m < low) | (m > high))
    if slow == 0:
        return
    for i in range(mean.shape[0]):
        m = mean[i]
        if (m < low) | (m > high):
            charge = min(_poisson(m, words[i], table), full_well)
            second = _normal(_mix(words[i] + _SECOND_DRAW), table)
            number = (charge + read_noise * second) * inverse_gain + (offset + half)
            number = min(max(number, zero), top)
            out[i] = np.uint16(np.int32(number))


def detector_constants(
    read_noise_electrons: float,
    electrons_per_dn: float,
    offset_dn: float,
    bits: int,
    full_well_electrons: float,
) -> F32:
    """What `digitise` needs of a detector, with the limits of the one-draw path in the last two places."""
    variance = read_noise_electrons**2
    # charge stays 6 sigma below the full well up to m + 6 sqrt(m) = full well
    high = (math.sqrt(full_well_electrons + 9.0) - 3.0) ** 2
    low = max(float(_ONE_DRAW_VARIANCE) - variance, 0.0)
    if read_noise_electrons < _ONE_DRAW_READ_NOISE:
        low = math.inf
    return np.array(
        [
            read_noise_electrons,
            variance,
            1.0 / electrons_per_dn,
            offset_dn,
            (1 << bits) - 1,
            full_well_electrons,
            low,
            high,
        ],
        dtype=np.float32,
    )


@njit(nogil=True, error_model="numpy")
def fixed_pattern(
    keys: U64,
    table: F32,
    width: int,
    height: int,
    prnu: float,
    dark_electrons_s: float,
    dark_nonuniformity: float,
    hot_fraction: float,
    hot_electrons_s: float,
) -> tuple[F32, F32]:
    """(response, dark current in electrons/s), float32[height, width] each; see `CameraModel`.

    keys: of the streams response, dark, hot, hot amount.
    """
    response = np.empty((height, width), np.float32)
    dark = np.empty((height, width), np.float32)
    for y in range(height):
        for x in range(width):
            step = np.uint64(y * width + x) * _GOLDEN
            gain = 1.0 + prnu * np.float64(_normal(_mix(keys[0] + step), table))
            spread = np.float64(_normal(_mix(keys[1] + step), table))
            rate = max(dark_electrons_s * (1.0 + dark_nonuniformity * float(spread)), 0.0)
            if np.float64(_mix(keys[2] + step) >> _S11) * 2.0**-53 < hot_fraction:
                u = (np.float64(_mix(keys[3] + step) >> _S11) + 0.5) * 2.0**-53
                rate -= hot_electrons_s * math.log(u)
            response[y, x] = np.float32(max(gain, 0.0))
            dark[y, x] = np.float32(rate)
    return response, dark


def uniforms(key: np.uint64, n: int) -> F64:
    """n numbers, uniform in (0, 1), of a stream."""
    words = np.empty(n, dtype=np.uint64)
    words_of(key, 0, words)
    return np.asarray(((words >> _S11).astype(np.float64) + 0.5) * 2.0**-53)
