"""Is a trial attitude the right one? All spots against the catalogue, and what the field should show.

Shared by the identification algorithms: whichever found the trial, it is judged here.
"""

from __future__ import annotations

import math

import numba
import numpy as np
import numpy.typing as npt

from ..attitude import matrix_kernel, quaternion_kernel
from ..catalogue.sky_cells import stars_in_cone_kernel
from ..work import Work

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int32]
CountArray = npt.NDArray[np.int64]

# Places of the counts that the kernels keep; the names are those of work.py.
COUNT_NAMES = (
    "kvector_queries",
    "kvector_hits",
    "angles_computed",
    "pairs_compared",
    "triads_tested",
    "triangles_tested",
    "pyramids_tested",
    "candidates_marked",
    "votes",
    "magnitudes_compared",
    "catalogue_angles",
    "spots_confirmed",
    "trial_stars_projected",
    "qmethod_stars",
    "qmethod_solves",
    "jacobi_rotations",
    "identifications",
    "spikes_taken",
    "cones_searched",
    "spots_followed",
    "trials_confirmed",
    "marks_scattered",
    "pairs_joined",
    "fourths_compared",
    "triads_joined",
    "third_sides",
    "cone_stars",
    "marks_stamped",
    "votes_cast",
)
KVECTOR_QUERIES, KVECTOR_HITS, ANGLES_COMPUTED, PAIRS_COMPARED = range(4)
TRIADS_TESTED, TRIANGLES_TESTED, PYRAMIDS_TESTED, CANDIDATES_MARKED, VOTES = range(4, 9)
MAGNITUDES_COMPARED, CATALOGUE_ANGLES, SPOTS_CONFIRMED, TRIAL_STARS_PROJECTED = range(9, 13)
QMETHOD_STARS, QMETHOD_SOLVES, JACOBI_ROTATIONS = range(13, 16)
IDENTIFICATIONS, SPIKES_TAKEN, CONES_SEARCHED, SPOTS_FOLLOWED, TRIALS_CONFIRMED = range(16, 21)
MARKS_SCATTERED, PAIRS_JOINED, FOURTHS_COMPARED, TRIADS_JOINED, THIRD_SIDES, CONE_STARS = range(21, 27)
MARKS_STAMPED, VOTES_CAST = range(27, 29)

OPERATIONS = 13  # the counts before this one are the stage identification's steps

FEW_MATCHES = 6  # below this, brightness is looked at too
MOST_NEAR = 256  # stars near one spot: more than any catalogue holds within a tolerance
# ASSUMED: of the words of a table of the stars so many stay at hand, half of a data cache of 32 KiB; its
# other half is the lists' that are read along.
MARKS_AT_HAND = 4096


def first_counts(spikes: int) -> CountArray:
    """The kernels' counts at the start of an identification of so many spikes."""
    counts = np.zeros(len(COUNT_NAMES), np.int64)
    counts[IDENTIFICATIONS] = 1
    counts[SPIKES_TAKEN] = spikes
    return counts


def work_of(counts: CountArray) -> Work:
    """The kernels' counts by name."""
    return Work({name: int(count) for name, count in zip(COUNT_NAMES, counts, strict=True) if count})


@numba.njit(nogil=True)
def scattered_kernel(marks: int, words: int) -> int:
    """How many of so many marks, written or read anywhere in a table of so many words, are not at hand."""
    return marks - marks * min(words, MARKS_AT_HAND) // max(words, 1)


@numba.njit(nogil=True)
def exhausted_kernel(counts: CountArray, limit: FloatArray) -> bool:
    """Whether the work has reached its limit, which is `IdentificationParameters.work_limit`."""
    operations = 0
    for place in range(OPERATIONS):
        operations += counts[place]
    cycles = 0.0
    for place in range(len(limit) - 2):
        cycles += counts[place] * limit[2 + place]
    exhausted: bool = operations >= limit[0] or cycles >= limit[1]
    return exhausted


@numba.njit(nogil=True)
def false_solutions_kernel(
    stars: int, spots: int, matched: int, spread_rad: float, tolerance_rad: float
) -> float:
    """How many solutions with so many matched spots chance gives per image.

    After Zhang et al. 2014 (15): any of the catalogue's stars can be the first spot; a second lies by
    chance in the ring at the right angle, 4 pi sin(angle) tolerance wide times long; the attitude is then
    fixed, and each further spot has a star by chance within the tolerance's circle; `matched` of the spots
    can be chosen in so many ways.
    ASSUMED: stars evenly over the sky, the angle of the first pair equal to the spots' spread.
    """
    if matched < 3 or matched > spots or stars < 1:
        return math.inf
    density = stars / (4.0 * math.pi)
    ways = math.lgamma(spots + 1.0) - math.lgamma(matched + 1.0) - math.lgamma(spots - matched + 1.0)
    ring = density * 4.0 * math.pi * math.sin(max(spread_rad, tolerance_rad)) * tolerance_rad
    circle = density * math.pi * tolerance_rad * tolerance_rad
    logarithm = ways + math.log(stars * ring) + (matched - 2) * math.log(circle)
    return math.exp(min(logarithm, 700.0))


@numba.njit(nogil=True)
def spread_kernel(b: FloatArray, count: int) -> float:
    """Largest angle of the first `count` directions from their mean, rad."""
    x = y = z = 0.0
    for i in range(count):
        x += b[i, 0]
        y += b[i, 1]
        z += b[i, 2]
    norm = math.sqrt(x * x + y * y + z * z)
    if norm == 0.0:
        return math.pi
    smallest = 1.0
    for i in range(count):
        smallest = min(smallest, (b[i, 0] * x + b[i, 1] * y + b[i, 2] * z) / norm)
    return math.acos(max(-1.0, smallest))


@numba.njit(nogil=True)
def separation_kernel(cos_angle: FloatArray) -> float:
    """Angle of the closest pair of a pair catalogue's ascending cosines, rad; 0 if there is none."""
    if len(cos_angle) == 0:
        return 0.0
    return math.acos(min(1.0, cos_angle[-1]))


@numba.njit(nogil=True)
def match_spots_kernel(
    b: FloatArray,
    q: FloatArray,
    unit_vectors: FloatArray,
    band_height_rad: float,
    band_first_cell: IntArray,
    cell_start: IntArray,
    cell_star: IntArray,
    separation_rad: float,
    radius_rad: float,
    searched_rad: float,
    only_star: IntArray,
    only_angle: FloatArray,
    star_index: IntArray,
    counts: CountArray,
) -> int:
    """Match every spot to the nearest star within radius_rad under q; a star only to its nearest spot.

    Writes star_index[n] (-1 where none) and returns the number of matches.
    only_star[n], only_angle[n]: a star that a spot is thought to be, or -1; and its angle, if a search with
    an earlier attitude found it alone within searched_rad, else inf. Where it must be the only one within
    radius_rad still, nothing is searched: no two stars are closer than separation_rad, and a spot has moved
    by no more than the sum of both angles. Both are kept up to date by searches as wide as searched_rad.
    """
    spots = len(b)
    a = np.empty((3, 3))
    matrix_kernel(q, a)
    angle = np.empty(spots)
    found = np.empty(MOST_NEAR, np.int32)
    matched = 0
    for spot in range(spots):
        x = a[0, 0] * b[spot, 0] + a[1, 0] * b[spot, 1] + a[2, 0] * b[spot, 2]
        y = a[0, 1] * b[spot, 0] + a[1, 1] * b[spot, 1] + a[2, 1] * b[spot, 2]
        z = a[0, 2] * b[spot, 0] + a[1, 2] * b[spot, 1] + a[2, 2] * b[spot, 2]
        star = only_star[spot]
        if radius_rad >= separation_rad and only_angle[spot] > searched_rad:
            star = -1  # never the only one for certain
        if star >= 0:
            counts[CATALOGUE_ANGLES] += 1
            counts[SPOTS_FOLLOWED] += 1
            dx = unit_vectors[star, 0] - x
            dy = unit_vectors[star, 1] - y
            dz = unit_vectors[star, 2] - z
            angle[spot] = 2.0 * math.asin(min(1.0, 0.5 * math.sqrt(dx * dx + dy * dy + dz * dz)))
            if (
                angle[spot] + radius_rad < separation_rad
                or only_angle[spot] + angle[spot] <= searched_rad - radius_rad
            ):
                star_index[spot] = star if angle[spot] <= radius_rad else -1
            else:
                star = -1
        if star < 0:
            near, tested = stars_in_cone_kernel(
                unit_vectors,
                band_height_rad,
                band_first_cell,
                cell_start,
                cell_star,
                x,
                y,
                z,
                radius_rad,
                found,
            )
            counts[CONES_SEARCHED] += 1
            counts[CATALOGUE_ANGLES] += tested
            counts[CONE_STARS] += tested
            star_index[spot] = -1
            smallest = 1e300
            for place in range(min(near, len(found))):
                dx = unit_vectors[found[place], 0] - x
                dy = unit_vectors[found[place], 1] - y
                dz = unit_vectors[found[place], 2] - z
                square = dx * dx + dy * dy + dz * dz
                if square < smallest:
                    smallest = square
                    star_index[spot] = found[place]
            angle[spot] = 2.0 * math.asin(min(1.0, 0.5 * math.sqrt(smallest)))
            if radius_rad >= searched_rad:
                only_star[spot] = star_index[spot] if near == 1 else -1
                only_angle[spot] = angle[spot]
        star = star_index[spot]
        if star < 0:
            continue
        matched += 1
        for earlier in range(spot):
            if star_index[earlier] == star:
                loser = spot if angle[earlier] <= angle[spot] else earlier
                star_index[loser] = -1
                matched -= 1
                break
    return matched


@numba.njit(nogil=True)
def refine_kernel(
    b: FloatArray, unit_vectors: FloatArray, star_index: IntArray, q: FloatArray, counts: CountArray
) -> int:
    """Attitude q of the matched spots at equal weights; returns how many there are (q untouched below 3)."""
    spots = len(b)
    measured = np.empty((spots, 3))
    reference = np.empty((spots, 3))
    matched = 0
    for spot in range(spots):
        star = star_index[spot]
        if star >= 0:
            for m in range(3):
                measured[matched, m] = b[spot, m]
                reference[matched, m] = unit_vectors[star, m]
            matched += 1
    if matched >= 3:
        counts[JACOBI_ROTATIONS] += quaternion_kernel(measured, reference, np.ones(spots), matched, q)
        counts[QMETHOD_STARS] += matched
        counts[QMETHOD_SOLVES] += 1
    return matched


@numba.njit(nogil=True)
def sort_kernel(values: FloatArray, count: int) -> None:
    """Sort the first `count` values in place, by insertion: there are few."""
    for i in range(1, count):
        value = values[i]
        place = i
        while place > 0 and values[place - 1] > value:
            values[place] = values[place - 1]
            place -= 1
        values[place] = value


@numba.njit(nogil=True)
def expected_kernel(
    q: FloatArray,
    normals: FloatArray,
    unit_vectors: FloatArray,
    hp_mag: npt.NDArray[np.float32],
    band_height_rad: float,
    band_first_cell: IntArray,
    cell_start: IntArray,
    cell_star: IntArray,
    star_index: IntArray,
    counts: CountArray,
) -> tuple[int, int]:
    """(catalogue stars in the field not dimmer than the median of the matched, how many are matched).

    The field is bounded by the four planes of Sarvi et al. 2014, (3)-(4).
    """
    spots = len(star_index)
    sorted_mag = np.empty(spots)
    matched = 0
    for spot in range(spots):
        if star_index[spot] >= 0:
            sorted_mag[matched] = hp_mag[star_index[spot]]
            matched += 1
    if matched == 0:
        return 0, 0
    sort_kernel(sorted_mag, matched)
    limit = sorted_mag[(matched - 1) // 2]
    smallest_z = 1.0
    for i in range(4):
        j = (i + 1) % 4
        x = normals[i, 1] * normals[j, 2] - normals[i, 2] * normals[j, 1]
        y = normals[i, 2] * normals[j, 0] - normals[i, 0] * normals[j, 2]
        z = normals[i, 0] * normals[j, 1] - normals[i, 1] * normals[j, 0]
        smallest_z = min(smallest_z, abs(z) / math.sqrt(x * x + y * y + z * z))
    a = np.empty((3, 3))
    matrix_kernel(q, a)
    found = np.empty(len(unit_vectors), np.int32)
    near, tested = stars_in_cone_kernel(
        unit_vectors,
        band_height_rad,
        band_first_cell,
        cell_start,
        cell_star,
        a[2, 0],
        a[2, 1],
        a[2, 2],
        math.acos(smallest_z),
        found,
    )
    counts[CONES_SEARCHED] += 1
    counts[CATALOGUE_ANGLES] += tested
    counts[CONE_STARS] += tested
    expected = 0
    seen = 0
    for place in range(near):
        star = found[place]
        if hp_mag[star] > limit:
            continue
        counts[TRIAL_STARS_PROJECTED] += 1
        inside = True
        for i in range(4):
            distance = 0.0
            for m in range(3):
                turned = (
                    a[m, 0] * unit_vectors[star, 0]
                    + a[m, 1] * unit_vectors[star, 1]
                    + a[m, 2] * unit_vectors[star, 2]
                )
                distance += turned * normals[i, m]
            if distance <= 0.0:
                inside = False
                break
        if not inside:
            continue
        expected += 1
        for spot in range(spots):
            if star_index[spot] == star:
                seen += 1
                break
    return expected, seen


@numba.njit(nogil=True)
def odd_brightness_kernel(
    magnitudes: FloatArray,
    hp_mag: npt.NDArray[np.float32],
    star_index: IntArray,
    tolerance_mag: float,
    counts: CountArray,
) -> int:
    """Matched spots whose brightness is off by more than tolerance_mag from the median offset."""
    spots = len(star_index)
    offset = np.empty(spots)
    matched = 0
    for spot in range(spots):
        if star_index[spot] >= 0:
            offset[matched] = magnitudes[spot] - hp_mag[star_index[spot]]
            matched += 1
    counts[MAGNITUDES_COMPARED] += matched
    if matched == 0:
        return 0
    ascending = offset.copy()
    sort_kernel(ascending, matched)
    middle = 0.5 * (ascending[(matched - 1) // 2] + ascending[matched // 2])
    odd = 0
    for i in range(matched):
        if not abs(offset[i] - middle) <= tolerance_mag:
            odd += 1
    return odd


@numba.njit(nogil=True)
def verify_kernel(
    b: FloatArray,
    magnitudes: FloatArray,
    q: FloatArray,
    unit_vectors: FloatArray,
    hp_mag: npt.NDArray[np.float32],
    band_height_rad: float,
    band_first_cell: IntArray,
    cell_start: IntArray,
    cell_star: IntArray,
    separation_rad: float,
    tolerance_rad: float,
    min_stars: int,
    normals: FloatArray,
    least_seen_share: float,
    magnitude_tolerance: float,
    star_index: IntArray,
    counts: CountArray,
) -> tuple[int, int, int]:
    """(matched, expected, seen) of the trial attitude q, which is refined; matched is 0 when the trial fails.

    star_index[n]: the stars that the trial is made of, -1 elsewhere; the matches are written there.
    separation_rad: no two stars of the catalogue are closer (`separation_kernel`).
    Three passes: a wide one, since a few stars close together fix the far end of the field badly, then two
    at the tolerance. A trial fails with fewer than min_stars matches, when too few of the stars that must
    be in the field are matched (field given: normals[4, 3], else normals[0, 3]), or when few matches do not
    agree in brightness.
    """
    spots = len(b)
    only_star = star_index.copy()
    only_angle = np.full(spots, np.inf)
    before = np.empty(spots, np.int32)
    matched = 0
    for trial in range(3):
        for spot in range(spots):
            before[spot] = star_index[spot]
        matched = match_spots_kernel(
            b,
            q,
            unit_vectors,
            band_height_rad,
            band_first_cell,
            cell_start,
            cell_star,
            separation_rad,
            2.0 * tolerance_rad if trial == 0 else tolerance_rad,
            2.0 * tolerance_rad,
            only_star,
            only_angle,
            star_index,
            counts,
        )
        if matched < min_stars:
            return 0, 0, 0
        if trial > 0:
            same = True
            for spot in range(spots):
                same = same and before[spot] == star_index[spot]
            if same:  # so is the attitude of these matches, and whatever would follow
                break
        refine_kernel(b, unit_vectors, star_index, q, counts)
    counts[SPOTS_CONFIRMED] += matched
    counts[TRIALS_CONFIRMED] += 1
    if (
        matched < FEW_MATCHES
        and odd_brightness_kernel(magnitudes, hp_mag, star_index, magnitude_tolerance, counts) > 1
    ):
        return 0, 0, 0
    expected = 0
    seen = 0
    if len(normals) == 4:
        expected, seen = expected_kernel(
            q,
            normals,
            unit_vectors,
            hp_mag,
            band_height_rad,
            band_first_cell,
            cell_start,
            cell_star,
            star_index,
            counts,
        )
        if seen < least_seen_share * expected:
            return 0, expected, seen
    return matched, expected, seen
