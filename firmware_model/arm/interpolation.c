/* Centroid by Gaussian interpolation: firmware_model/image/interpolation.py (interpolate), paper Z (4)-(6):
 * the ratio of two neighbouring columns or rows gives the place of a spot of known width.
 *
 * Sums of three pixels are whole numbers; the quadratic equation of each axis is double: it is solved once an
 * axis, and its terms cancel to a few of their digits. */
#include "interpolation.h"

#include <math.h>

/* As in interpolation.py, where each is explained. */
#define DEVELOPED_AT_PX (-0.25)
#define FURTHEST_PX 0.5
#define NEAR_COM_PX 0.1
#define NEAR_COM_SIGMA 3.0
#define MOST_FROM_COM_PX 0.5

#define NONE 1e9 /* px: no place */

/* The star's place from the middle of the column second, positive away from the column first. */
static double offset_from_ratio(double first, double second, const st_interpolation_terms *terms)
{
    double a = first * terms->second[2] - second * terms->first[2];
    double b = first * terms->second[1] - second * terms->first[1];
    double c = first * terms->second[0] - second * terms->first[0];
    double square = b * b - 4.0 * a * c;
    if (!(square >= 0.0))
        return NONE;
    double divisor = b + sqrt(square);
    if (!(divisor > 0.0))
        return NONE;
    return DEVELOPED_AT_PX - 2.0 * c / divisor;
}

/* The star's place from the middle of three columns; sums over the background, ST_BACKGROUND_BITS. */
static double place_on_axis(const int64_t sums[3], const st_interpolation_terms *terms)
{
    double before = (double)sums[0];
    double middle = (double)sums[1];
    double after = (double)sums[2];
    int32_t left = sums[0] >= sums[2];
    double larger = left ? before : after;
    double smaller = left ? after : before;
    if (!(larger > 0.0 && middle > 0.0))
        return NONE;
    if (smaller > 0.0 && middle * middle < terms->least_square_ratio * larger * smaller)
        return NONE;
    double x = offset_from_ratio(larger, middle, terms);
    if (!(fabs(x - DEVELOPED_AT_PX) <= FURTHEST_PX))
        return NONE;
    return left ? x : -x;
}

int32_t st_interpolate(const st_image *image, const st_surroundings *about, int32_t background,
                       double com_sigma_px, const st_interpolation_terms *terms, double *x_px, double *y_px)
{
    int32_t columns = image->columns;
    /* Places are within the image, so not negative: truncation is rounding down. */
    int32_t middle_x = (int32_t)(*x_px + 0.5);
    int32_t middle_y = (int32_t)(*y_px + 0.5);
    if (middle_x < 1 || middle_y < 1 || middle_x > columns - 2 || middle_y > image->rows - 2)
        return 0;
    int32_t peak_x = middle_x;
    int32_t peak_y = middle_y;
    int32_t largest = image->pixels[peak_y * columns + peak_x];
    for (int32_t row = middle_y - 1; row <= middle_y + 1; row++) {
        const uint16_t *line = image->pixels + row * columns;
        for (int32_t column = middle_x - 1; column <= middle_x + 1; column++) {
            if (line[column] > largest) {
                largest = line[column];
                peak_x = column;
                peak_y = row;
            }
        }
    }
    if (peak_x < 1 || peak_y < 1 || peak_x > columns - 2 || peak_y > image->rows - 2)
        return 0;

    int64_t across[3], down[3];
    int32_t sums_across[3] = {0}, sums_down[3] = {0};
    const uint16_t *pixel = image->pixels + peak_y * columns + peak_x;
    const uint8_t *mask = about->mask + (peak_y - about->top) * about->width + peak_x - about->left;
    for (int32_t y = -1; y <= 1; y++)
        for (int32_t x = -1; x <= 1; x++) {
            int32_t value = pixel[y * columns + x];
            if (mask[y * about->width + x] == ST_OTHER)
                return 0;
            if (y == 0 || terms->half_height_px)
                sums_across[x + 1] += value;
            if (x == 0 || terms->half_height_px)
                sums_down[y + 1] += value;
        }
    int32_t of_background = terms->half_height_px ? 3 : 1;
    for (int32_t i = 0; i < 3; i++) {
        across[i] = ((int64_t)sums_across[i] << ST_BACKGROUND_BITS) - (int64_t)background * of_background;
        down[i] = ((int64_t)sums_down[i] << ST_BACKGROUND_BITS) - (int64_t)background * of_background;
    }
    double x = peak_x + place_on_axis(across, terms);
    double y = peak_y + place_on_axis(down, terms);
    double most = NEAR_COM_PX + NEAR_COM_SIGMA * com_sigma_px;
    if (most > MOST_FROM_COM_PX)
        most = MOST_FROM_COM_PX;
    if (!(fabs(x - *x_px) <= most && fabs(y - *y_px) <= most))
        return 0;
    *x_px = x;
    *y_px = y;
    return 1;
}
