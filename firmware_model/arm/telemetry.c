/* Telemetry out: the packets that protocol/pus/registry.py's encode_telemetry builds (CCSDS 133.0-B-2 4.1.3
 * primary header, ECSS-E-ST-70-41C 7.4.3.1 secondary header, packet error control) and their SLIP frames
 * (RFC 1055), protocol/framing.py. Fields are stored big-endian byte by byte: most lie at odd addresses.
 * Floats go out in single precision, rounded to nearest by the compiler's conversion. */
#include "telemetry.h"

#include <string.h>

#include "crc.h"

#define SLIP_END 0xc0
#define SLIP_ESC 0xdb
#define SLIP_ESC_END 0xdc
#define SLIP_ESC_ESC 0xdd

static uint8_t *put_u8(uint8_t *at, uint32_t value)
{
    at[0] = (uint8_t)value;
    return at + 1;
}

static uint8_t *put_u16(uint8_t *at, uint32_t value)
{
    at[0] = (uint8_t)(value >> 8);
    at[1] = (uint8_t)value;
    return at + 2;
}

static uint8_t *put_u24(uint8_t *at, uint32_t value)
{
    at[0] = (uint8_t)(value >> 16);
    return put_u16(at + 1, value);
}

static uint8_t *put_u32(uint8_t *at, uint32_t value)
{
    at[0] = (uint8_t)(value >> 24);
    return put_u24(at + 1, value);
}

static uint8_t *put_f32(uint8_t *at, double value)
{
    float single = (float)value;
    uint32_t word;

    memcpy(&word, &single, sizeof word);
    return put_u32(at, word);
}

static uint8_t *put_f64(uint8_t *at, double value)
{
    uint64_t word;

    memcpy(&word, &value, sizeof word);
    at = put_u32(at, (uint32_t)(word >> 32));
    return put_u32(at, (uint32_t)word);
}

/* Both headers; where the source data go. The length is put in by `finish`. */
static uint8_t *begin(const st_telemetry_header *header, uint8_t *packet)
{
    uint8_t *at = packet;

    at = put_u16(at, 0x0800 | header->apid); /* version 0, telemetry, with secondary header */
    at = put_u16(at, 0xc000 | header->sequence_count); /* unsegmented */
    at = put_u16(at, 0);
    at = put_u8(at, 0x20 | header->time_status); /* PUS version 2 */
    at = put_u8(at, header->service);
    at = put_u8(at, header->subservice);
    at = put_u16(at, header->message_count);
    at = put_u16(at, header->destination_id);
    at = put_u32(at, header->time_coarse);
    return put_u24(at, header->time_fine);
}

/* Length and error control of a packet whose data end before `at`; the packet's length. */
static int32_t finish(uint8_t *packet, uint8_t *at)
{
    int32_t length = (int32_t)(at - packet);

    put_u16(packet + 4, (uint32_t)length + 2 - 7);
    put_u16(at, st_crc16(packet, length));
    return length + 2;
}

int32_t st_attitude_packet(const st_telemetry_header *header, const st_attitude_report *report,
                           uint8_t *packet)
{
    uint8_t *at = begin(header, packet);
    int32_t i;

    at = put_u32(at, report->frame_index);
    at = put_u32(at, report->mid_exposure_coarse);
    at = put_u24(at, report->mid_exposure_fine);
    at = put_u8(at, report->time_status);
    at = put_u8(at, report->mode);
    at = put_u8(at, report->valid);
    at = put_u32(at, report->reasons);
    for (i = 0; i < 4; i++)
        at = put_f64(at, report->q[i]);
    for (i = 0; i < 6; i++)
        at = put_f32(at, report->covariance_rad2[i]);
    at = put_u8(at, report->rate_valid);
    for (i = 0; i < 3; i++)
        at = put_f32(at, report->rate_rad_s[i]);
    at = put_u16(at, report->spots_detected);
    at = put_u16(at, report->stars_identified);
    at = put_u16(at, report->windows);
    at = put_u16(at, report->window_half_width_px);
    at = put_f32(at, report->residual_rms_arcsec);
    at = put_f32(at, report->background_dn);
    at = put_f32(at, report->noise_dn);
    at = put_u32(at, report->exposure_us);
    at = put_u32(at, report->cycles);
    at = put_u32(at, report->latency_us);
    at = put_u8(at, report->late);
    at = put_u16(at, report->frames_dropped_before);
    at = put_f32(at, report->false_match_probability);
    at = put_u8(at, report->rate_covariance_valid);
    for (i = 0; i < 6; i++)
        at = put_f32(at, report->rate_covariance_rad2_s2[i]);
    return finish(packet, at);
}

int32_t st_verification_packet(const st_telemetry_header *header, const uint8_t *request, uint8_t *packet)
{
    uint8_t *at = begin(header, packet);
    int32_t i;

    for (i = 0; i < 4; i++)
        *at++ = request[i];
    return finish(packet, at);
}

int32_t st_image_packet(const st_telemetry_header *header, uint32_t transaction_id, uint32_t part_number,
                        const st_stored_image *image, int32_t offset, int32_t count, uint8_t *packet)
{
    uint8_t *at = begin(header, packet);

    at = put_u16(at, transaction_id);
    at = put_u16(at, part_number);
    st_image_bytes(image, offset, count, at);
    return finish(packet, at + count);
}

int32_t st_slip_encode(const uint8_t *packet, int32_t count, uint8_t *line)
{
    uint8_t *at = line;

    *at++ = SLIP_END;
    for (; count > 0; count--) {
        uint32_t byte = *packet++;
        if (byte == SLIP_END) {
            *at++ = SLIP_ESC;
            byte = SLIP_ESC_END;
        } else if (byte == SLIP_ESC) {
            *at++ = SLIP_ESC;
            byte = SLIP_ESC_ESC;
        }
        *at++ = (uint8_t)byte;
    }
    *at++ = SLIP_END;
    return (int32_t)(at - line);
}
