/* Telecommands in: bytes of the line out of their SLIP frames (RFC 1055; protocol/framing.py's SlipDecoder)
 * and the checks of the packets' headers in the order of protocol/pus/registry.py: lengths and
 * error control first, for only then can the other fields be believed. Whole numbers throughout. */
#include "telecommand.h"

#include "crc.h"

#define SLIP_END 0xc0
#define SLIP_ESC 0xdb
#define SLIP_ESC_END 0xdc
#define SLIP_ESC_ESC 0xdd

#define HEADER_BYTES 6
#define LEAST_BYTES 13 /* primary header, secondary header, error control */

/* MalformedReason */
#define TOO_SHORT 1
#define TOO_LONG 2
#define LENGTH_MISMATCH 3
#define BAD_CRC 4
#define BAD_VERSION 5
#define NOT_TELECOMMAND 6
#define UNKNOWN_APID 8
#define NO_SECONDARY_HEADER 9
#define SEGMENTED 10
#define BAD_PUS_VERSION 11
#define FRAME_OVERSIZED 16
#define FRAME_BAD_ESCAPE 17

static uint32_t get_u16(const uint8_t *at)
{
    return (uint32_t)at[0] << 8 | at[1];
}

static int32_t reason_of(const uint8_t *packet, int32_t count, uint32_t apid)
{
    uint32_t first, sequence;

    if (count < LEAST_BYTES)
        return TOO_SHORT;
    if (count > ST_MOST_TELECOMMAND_BYTES)
        return TOO_LONG;
    if ((uint32_t)count != HEADER_BYTES + get_u16(packet + 4) + 1)
        return LENGTH_MISMATCH;
    if (st_crc16(packet, count) != 0)
        return BAD_CRC;
    first = get_u16(packet);
    sequence = get_u16(packet + 2);
    if (first >> 13 != 0)
        return BAD_VERSION;
    if (!(first & 0x1000))
        return NOT_TELECOMMAND;
    if ((first & 0x7ff) != apid)
        return UNKNOWN_APID;
    if (!(first & 0x0800))
        return NO_SECONDARY_HEADER;
    if (sequence >> 14 != 3)
        return SEGMENTED;
    if (packet[6] >> 4 != 2)
        return BAD_PUS_VERSION;
    return 0;
}

int32_t st_telecommand_check(const uint8_t *packet, int32_t count, uint32_t apid, st_telecommand *telecommand)
{
    telecommand->length = count;
    telecommand->reason = reason_of(packet, count, apid);
    if (telecommand->reason == 0) {
        telecommand->sequence_count = get_u16(packet + 2) & 0x3fff;
        telecommand->ack = packet[6] & 0x0f;
        telecommand->service = packet[7];
        telecommand->subservice = packet[8];
        telecommand->source_id = get_u16(packet + 9);
    }
    return telecommand->reason;
}

int32_t st_slip_receive(st_slip_decoder *decoder, const uint8_t *data, int32_t count,
                        st_telecommand *telecommand, int32_t *ended)
{
    const uint8_t *at = data;
    const uint8_t *end = data + count;
    int32_t length = decoder->length;
    int32_t line_bytes = decoder->line_bytes;
    int32_t escaping = decoder->escaping;
    int32_t reason = decoder->reason;

    *ended = 0;
    while (at < end) {
        uint32_t byte = *at++;
        if (byte == SLIP_END) {
            if (escaping)
                reason = FRAME_BAD_ESCAPE;
            if (line_bytes > 0) {
                telecommand->reason = reason;
                telecommand->length = reason ? line_bytes : length;
                *ended = 1;
            }
            length = line_bytes = escaping = reason = 0;
            if (*ended)
                break;
            continue;
        }
        line_bytes++;
        if (reason)
            continue;
        if (escaping) {
            escaping = 0;
            if (byte == SLIP_ESC_END) {
                byte = SLIP_END;
            } else if (byte == SLIP_ESC_ESC) {
                byte = SLIP_ESC;
            } else {
                reason = FRAME_BAD_ESCAPE;
                continue;
            }
        } else if (byte == SLIP_ESC) {
            escaping = 1;
            continue;
        }
        if (length >= ST_MOST_TELECOMMAND_BYTES)
            reason = FRAME_OVERSIZED;
        else
            decoder->frame[length++] = (uint8_t)byte;
    }
    decoder->length = length;
    decoder->line_bytes = line_bytes;
    decoder->escaping = escaping;
    decoder->reason = reason;
    return (int32_t)(at - data);
}

int32_t st_telecommands(st_slip_decoder *decoder, const uint8_t *data, int32_t count, uint32_t apid,
                        st_telecommand *found, int32_t most)
{
    int32_t number = 0;

    while (count > 0 && number < most) {
        int32_t ended;
        int32_t taken = st_slip_receive(decoder, data, count, found + number, &ended);
        data += taken;
        count -= taken;
        if (!ended)
            break;
        if (found[number].reason == 0)
            st_telecommand_check(decoder->frame, found[number].length, apid, found + number);
        number++;
    }
    return number;
}
