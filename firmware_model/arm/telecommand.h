/* Telecommands in; see telecommand.c. */
#ifndef ST_TELECOMMAND_H
#define ST_TELECOMMAND_H

#include <stdint.h>

#define ST_MOST_TELECOMMAND_BYTES 1024

/* The receiver of the line: the frame in progress and where in it the line is; 0 at start. */
typedef struct {
    uint8_t frame[ST_MOST_TELECOMMAND_BYTES];
    int32_t length;     /* bytes of the frame so far, escapes undone */
    int32_t line_bytes; /* as they came */
    int32_t escaping;   /* the last byte was ESC */
    int32_t reason;     /* why the frame is thrown away, 0: it is not */
} st_slip_decoder;

/* What came between two ENDs: a telecommand whose headers are right, or the reason why not. */
typedef struct {
    int32_t reason; /* 0, or the number of protocol/pus/enumerations.py's MalformedReason */
    int32_t length; /* of the packet; of a frame thrown away its bytes on the line */
    uint32_t sequence_count;
    uint32_t ack;
    uint32_t service;
    uint32_t subservice;
    uint32_t source_id;
} st_telecommand;

/* Checks a packet as far as its headers say what it is; the rest is its service's. Returns the reason. */
int32_t st_telecommand_check(const uint8_t *packet, int32_t count, uint32_t apid,
                             st_telecommand *telecommand);

/* Bytes of the line, up to the END that completes a frame. Returns how many were taken; *ended: 1 if there
   was such an END. Then the frame's bytes stay in the decoder until it is given more. */
int32_t st_slip_receive(st_slip_decoder *decoder, const uint8_t *data, int32_t count,
                        st_telecommand *telecommand, int32_t *ended);

/* All that `count` bytes of the line complete, to found[most]; returns how many there are. */
int32_t st_telecommands(st_slip_decoder *decoder, const uint8_t *data, int32_t count, uint32_t apid,
                        st_telecommand *found, int32_t most);

#endif
