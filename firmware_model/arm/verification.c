/* Is a trial attitude the right one? All spikes against the catalogue, and what the field should show:
 * firmware_model/identification/verification.py (match_spots_kernel, refine_kernel, expected_kernel,
 * odd_brightness_kernel, verify_kernel).
 *
 * Software double precision throughout, in the order of the Python stage's operations, so that the same stars
 * are matched; magnitudes of the catalogue stay single precision, as they are stored. Room that grows with
 * the number of spikes is static. */
#include "verification.h"

#include <math.h>

#include "attitude.h"
#include "kvector.h"

#define MOST_NEAR 256 /* stars near one spike: more than any catalogue holds within a tolerance */
#define FEW_MATCHES 6 /* below this, brightness is looked at too */

static double spike_angle[ST_MOST_SPIKES];
static double only_angle_of[ST_MOST_SPIKES];
static double measured[3 * ST_MOST_SPIKES];
static double reference[3 * ST_MOST_SPIKES];
static double weight[ST_MOST_SPIKES];
static double offset_mag[ST_MOST_SPIKES];
static double ascending_mag[ST_MOST_SPIKES];
static float matched_mag[ST_MOST_SPIKES];
static int32_t only_star_of[ST_MOST_SPIKES];
static int32_t before[ST_MOST_SPIKES];

int32_t st_match_spots(const st_spikes *spikes, const double *q, const st_star_table *stars,
                       double separation_rad, double radius_rad, double searched_rad, int32_t *only_star,
                       double *only_angle, int32_t *star_index)
{
    const double *unit_vectors = stars->cells.unit_vectors;
    int32_t separable = radius_rad < separation_rad;
    int32_t wide = radius_rad >= searched_rad;
    double spared_rad = searched_rad - radius_rad;
    int32_t matched = 0;
    double a[9];
    int32_t found[MOST_NEAR];

    st_matrix(q, a);
    for (int32_t spike = 0; spike < spikes->count; spike++) {
        const double *b = spikes->b + 3 * spike;
        double turned[3];
        for (int32_t m = 0; m < 3; m++)
            turned[m] = a[m] * b[0] + a[m + 3] * b[1] + a[m + 6] * b[2];
        double angle = 0.0;
        int32_t star = only_star[spike];
        if (star >= 0 && !separable && only_angle[spike] > searched_rad)
            star = -1; /* never the only one for certain */
        if (star >= 0) {
            angle = st_angle(unit_vectors + 3 * star, turned);
            if (angle + radius_rad < separation_rad || only_angle[spike] + angle <= spared_rad)
                star_index[spike] = angle <= radius_rad ? star : -1;
            else
                star = -1;
        }
        if (star < 0) {
            int32_t near = st_stars_in_cone(&stars->cells, turned[0], turned[1], turned[2], radius_rad, found,
                                            MOST_NEAR);
            int32_t nearest = -1;
            double smallest = 1e300;
            for (int32_t place = 0; place < near && place < MOST_NEAR; place++) {
                const double *v = unit_vectors + 3 * found[place];
                double dx = v[0] - turned[0];
                double dy = v[1] - turned[1];
                double dz = v[2] - turned[2];
                double square = dx * dx + dy * dy + dz * dz;
                if (square < smallest) {
                    smallest = square;
                    nearest = found[place];
                }
            }
            double half_chord = nearest < 0 ? 1.0 : 0.5 * sqrt(smallest);
            angle = 2.0 * asin(half_chord < 1.0 ? half_chord : 1.0);
            star_index[spike] = nearest;
            if (wide) {
                only_star[spike] = near == 1 ? nearest : -1;
                only_angle[spike] = angle;
            }
        }
        spike_angle[spike] = angle;
        star = star_index[spike];
        if (star < 0)
            continue;
        matched++;
        for (int32_t earlier = 0; earlier < spike; earlier++)
            if (star_index[earlier] == star) {
                star_index[spike_angle[earlier] <= angle ? spike : earlier] = -1;
                matched--;
                break;
            }
    }
    return matched;
}

int32_t st_refine(const st_spikes *spikes, const st_star_table *stars, const int32_t *star_index, double *q)
{
    int32_t matched = 0;

    for (int32_t spike = 0; spike < spikes->count; spike++) {
        int32_t star = star_index[spike];
        if (star < 0)
            continue;
        for (int32_t m = 0; m < 3; m++) {
            measured[3 * matched + m] = spikes->b[3 * spike + m];
            reference[3 * matched + m] = stars->cells.unit_vectors[3 * star + m];
        }
        weight[matched++] = 1.0;
    }
    if (matched >= 3)
        st_quaternion(measured, reference, weight, matched, q);
    return matched;
}

/* Sorted by insertion: there are few. */
static void sort_single(float *values, int32_t count)
{
    for (int32_t i = 1; i < count; i++) {
        float value = values[i];
        int32_t place = i;
        for (; place > 0 && values[place - 1] > value; place--)
            values[place] = values[place - 1];
        values[place] = value;
    }
}

static void sort_double(double *values, int32_t count)
{
    for (int32_t i = 1; i < count; i++) {
        double value = values[i];
        int32_t place = i;
        for (; place > 0 && values[place - 1] > value; place--)
            values[place] = values[place - 1];
        values[place] = value;
    }
}

/* Cosine of the angle from the boresight to the corner farthest from it. */
static double farthest_corner(const double *normals)
{
    double smallest_z = 1.0;

    for (int32_t i = 0; i < 4; i++) {
        const double *n = normals + 3 * i;
        const double *next = normals + 3 * ((i + 1) & 3);
        double x = n[1] * next[2] - n[2] * next[1];
        double y = n[2] * next[0] - n[0] * next[2];
        double z = n[0] * next[1] - n[1] * next[0];
        double share = fabs(z) / sqrt(x * x + y * y + z * z);
        if (share < smallest_z)
            smallest_z = share;
    }
    return smallest_z;
}

void st_expected(const double *q, const double *normals, const st_star_table *stars,
                 const int32_t *star_index, int32_t spikes, int32_t *expected, int32_t *seen)
{
    int32_t matched = 0;
    double a[9];

    *expected = 0;
    *seen = 0;
    for (int32_t spike = 0; spike < spikes; spike++)
        if (star_index[spike] >= 0)
            matched_mag[matched++] = stars->hp_mag[star_index[spike]];
    if (matched == 0)
        return;
    sort_single(matched_mag, matched);
    float limit = matched_mag[(matched - 1) / 2];
    double smallest_z = farthest_corner(normals);
    st_matrix(q, a);
    int32_t near = st_stars_in_cone(&stars->cells, a[6], a[7], a[8], acos(smallest_z), stars->near,
                                    stars->stars);
    for (int32_t place = 0; place < near; place++) {
        int32_t star = stars->near[place];
        if (stars->hp_mag[star] > limit)
            continue;
        const double *v = stars->cells.unit_vectors + 3 * star;
        double turned[3];
        for (int32_t m = 0; m < 3; m++)
            turned[m] = st_dot(a + 3 * m, v);
        int32_t plane = 0;
        while (plane < 4 && st_dot(turned, normals + 3 * plane) > 0.0)
            plane++;
        if (plane < 4)
            continue;
        ++*expected;
        for (int32_t spike = 0; spike < spikes; spike++)
            if (star_index[spike] == star) {
                ++*seen;
                break;
            }
    }
}

int32_t st_odd_brightness(const double *magnitudes, const float *hp_mag, const int32_t *star_index,
                          int32_t spikes, double tolerance_mag)
{
    int32_t matched = 0;
    int32_t odd = 0;

    for (int32_t spike = 0; spike < spikes; spike++)
        if (star_index[spike] >= 0) {
            offset_mag[matched] = magnitudes[spike] - (double)hp_mag[star_index[spike]];
            ascending_mag[matched] = offset_mag[matched];
            matched++;
        }
    if (matched == 0)
        return 0;
    sort_double(ascending_mag, matched);
    double middle = 0.5 * (ascending_mag[(matched - 1) / 2] + ascending_mag[matched / 2]);
    for (int32_t i = 0; i < matched; i++)
        if (!(fabs(offset_mag[i] - middle) <= tolerance_mag))
            odd++;
    return odd;
}

st_verified st_verify(const st_spikes *spikes, double *q, const st_star_table *stars, const st_limits *limits,
                      int32_t min_stars, int32_t *star_index)
{
    const st_verified failed = {0, 0, 0};
    st_verified verified = {0, 0, 0};
    double wide_rad = 2.0 * limits->tolerance_rad;

    for (int32_t spike = 0; spike < spikes->count; spike++) {
        only_star_of[spike] = star_index[spike];
        only_angle_of[spike] = INFINITY;
    }
    for (int32_t trial = 0; trial < 3; trial++) {
        for (int32_t spike = 0; spike < spikes->count; spike++)
            before[spike] = star_index[spike];
        verified.matched = st_match_spots(spikes, q, stars, limits->separation_rad,
                                          trial == 0 ? wide_rad : limits->tolerance_rad, wide_rad,
                                          only_star_of, only_angle_of, star_index);
        if (verified.matched < min_stars)
            return failed;
        if (trial > 0) {
            int32_t spike = 0;
            while (spike < spikes->count && before[spike] == star_index[spike])
                spike++;
            if (spike ==
                spikes->count) /* the same matches, so the same attitude, and whatever would follow */
                break;
        }
        st_refine(spikes, stars, star_index, q);
    }
    if (verified.matched < FEW_MATCHES && st_odd_brightness(spikes->magnitudes, stars->hp_mag, star_index,
                                                            spikes->count, limits->magnitude_tolerance) > 1)
        return failed;
    if (limits->field_given) {
        st_expected(q, limits->normals, stars, star_index, spikes->count, &verified.expected, &verified.seen);
        if (verified.seen < limits->least_seen_share * verified.expected)
            verified.matched = 0;
    }
    return verified;
}
