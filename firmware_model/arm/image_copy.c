/* A part of the captured image for the packet that downloads it: st_emulator/device/image_memory.py, which
 * keeps header and pixels as one string of bytes. Here the pixels stay in the frame buffer, where the camera
 * wrote them little-endian, and their bytes are swapped on the way out. A part may start within the header or
 * within a pixel, since the header has an odd length. */
#include "image_copy.h"

void st_image_bytes(const st_stored_image *image, int32_t offset, int32_t count, uint8_t *out)
{
    const uint16_t *pixel;

    for (; offset < image->header_bytes && count > 0; count--)
        *out++ = image->header[offset++];
    if (count <= 0)
        return;
    offset -= image->header_bytes;
    pixel = image->pixels + (offset >> 1);
    if (offset & 1) {
        *out++ = (uint8_t)*pixel++;
        count--;
    }
    for (; count >= 2; count -= 2) {
        uint32_t value = *pixel++;
        out[0] = (uint8_t)(value >> 8);
        out[1] = (uint8_t)value;
        out += 2;
    }
    if (count > 0)
        *out = (uint8_t)(*pixel >> 8);
}
