/* The captured image and its parts; see image_copy.c. */
#ifndef ST_IMAGE_COPY_H
#define ST_IMAGE_COPY_H

#include <stdint.h>

/* An image for download: its header as it goes out, then the pixels as the camera left them. */
typedef struct {
    const uint8_t *header;
    int32_t header_bytes;
    const uint16_t *pixels;
} st_stored_image;

/* Bytes offset .. offset + count - 1 of the image as it goes out, header first, pixels big-endian. */
void st_image_bytes(const st_stored_image *image, int32_t offset, int32_t count, uint8_t *out);

#endif
