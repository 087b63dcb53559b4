/* CRC-16 of packets and images; see crc.c. */
#ifndef ST_CRC_H
#define ST_CRC_H

#include <stdint.h>

/* CRC-16 of `count` bytes, by table. 0 over a packet whose error control is right. */
uint32_t st_crc16(const uint8_t *data, int32_t count);

/* CRC-16 of the bytes of `count` pixels, the high byte of each first. */
uint32_t st_crc16_pixels(const uint16_t *pixels, int32_t count);

/* As st_crc16, bit by bit. */
uint32_t st_crc16_bitwise(const uint8_t *data, int32_t count);

#endif
