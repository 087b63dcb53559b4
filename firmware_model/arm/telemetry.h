/* Telemetry packets and SLIP frames; see telemetry.c. */
#ifndef ST_TELEMETRY_H
#define ST_TELEMETRY_H

#include <stdint.h>

#include "image_copy.h"

#define ST_MOST_TELEMETRY_BYTES 4095

/* What the headers of a packet say but its length. */
typedef struct {
    uint32_t apid;
    uint32_t sequence_count;
    uint32_t service;
    uint32_t subservice;
    uint32_t message_count;
    uint32_t destination_id;
    uint32_t time_status;
    uint32_t time_coarse; /* TAI seconds since 1958-01-01 */
    uint32_t time_fine;   /* 2^-24 s */
} st_telemetry_header;

/* The fields of TM[130,1] as the firmware has them, the doubles first. */
typedef struct {
    double q[4];
    double covariance_rad2[6]; /* xx, xy, xz, yy, yz, zz */
    double rate_rad_s[3];
    double rate_covariance_rad2_s2[6]; /* likewise */
    double residual_rms_arcsec;
    double background_dn;
    double noise_dn;
    double false_match_probability;
    uint32_t frame_index;
    uint32_t mid_exposure_coarse;
    uint32_t mid_exposure_fine;
    uint32_t time_status;
    uint32_t mode;
    uint32_t valid;
    uint32_t reasons;
    uint32_t rate_valid;
    uint32_t rate_covariance_valid;
    uint32_t spots_detected;
    uint32_t stars_identified;
    uint32_t windows;
    uint32_t window_half_width_px;
    uint32_t exposure_us;
    uint32_t cycles;
    uint32_t latency_us;
    uint32_t late;
    uint32_t frames_dropped_before;
} st_attitude_report;

/* Each writes a whole packet, packet error control included, and returns its length. */

/* TM[130,1]. */
int32_t st_attitude_packet(const st_telemetry_header *header, const st_attitude_report *report,
                           uint8_t *packet);

/* TM[1,1], TM[1,3], TM[1,7]: a telecommand was accepted, started, completed; request[4]: how it starts. */
int32_t st_verification_packet(const st_telemetry_header *header, const uint8_t *request, uint8_t *packet);

/* TM[13,1] to TM[13,3]: bytes offset .. offset + count - 1 of an image. */
int32_t st_image_packet(const st_telemetry_header *header, uint32_t transaction_id, uint32_t part_number,
                        const st_stored_image *image, int32_t offset, int32_t count, uint8_t *packet);

/* A packet as a SLIP frame, END on both sides; line[2 * count + 2] suffices. Returns the frame's length. */
int32_t st_slip_encode(const uint8_t *packet, int32_t count, uint8_t *line);

#endif
