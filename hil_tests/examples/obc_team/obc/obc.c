/* A tiny on-board computer: it wants an attitude and keeps the spacecraft safe without one.
 *
 *   obc serial DEVICE APID          a serial line or pseudo-terminal: PUS packets in SLIP frames
 *   obc can INTERFACE NODE APID     a CAN bus: cyclic frames, and telecommands by ISO-TP
 *
 * Written from the interface control document alone. It commands acquisition whenever the star tracker is in
 * STANDBY, points once three attitudes in a row are valid, and goes to SAFE when four are not, or none comes
 * for a second. What it does it says on standard output, a line each:
 *
 *   ACQUIRE | POINTING | SAFE invalid | SAFE silence | ATTITUDE frame x y z w | BAD (a frame with an error)
 */
#include <errno.h>
#include <fcntl.h>
#include <linux/can.h>
#include <net/if.h>
#include <poll.h>
#include <signal.h>
#include <stdbool.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/ioctl.h>
#include <sys/prctl.h>
#include <sys/socket.h>
#include <termios.h>
#include <time.h>
#include <unistd.h>

enum { STANDBY = 2, START_ACQUISITION = 2, SOURCE = 7 };
/* Silence: eight frames of a unit at 4 Hz, and longer than a bench computer is held up by other work. */
enum { GOOD_IN_A_ROW = 3, BAD_IN_A_ROW = 4, SILENCE_MS = 2000, AGAIN_MS = 1000, TICK_MS = 20 };
enum { LONGEST_PACKET = 4096 };

static int port;
static bool on_can;
static unsigned apid, node, sequence_count;
static bool pointing, safe;
static int good, bad;
static int64_t last_valid_ms, last_acquire_ms = -AGAIN_MS;

static int64_t now_ms(void)
{
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return now.tv_sec * 1000LL + now.tv_nsec / 1000000;
}

static void give_up(const char *what)
{
    fprintf(stderr, "obc: %s: %s\n", what, strerror(errno));
    exit(2);
}

static uint16_t crc16(const uint8_t *data, size_t length)
{
    uint16_t crc = 0xFFFF;
    while (length--) {
        crc ^= (uint16_t)(*data++ << 8);
        for (int bit = 0; bit < 8; bit++) {
            crc = (uint16_t)(crc & 0x8000 ? crc << 1 ^ 0x1021 : crc << 1);
        }
    }
    return crc;
}

static double f64(const uint8_t *at)
{
    uint64_t bits = 0;
    for (int i = 0; i < 8; i++) {
        bits = bits << 8 | at[i];
    }
    double value;
    memcpy(&value, &bits, sizeof value);
    return value;
}

static uint32_t u32(const uint8_t *at)
{
    return (uint32_t)at[0] << 24 | (uint32_t)at[1] << 16 | (uint32_t)at[2] << 8 | at[3];
}

/* -- telecommands */

static void put(const uint8_t *bytes, size_t length)
{
    if (write(port, bytes, length) < 0 && errno != EAGAIN && errno != ENOBUFS && errno != ENETDOWN) {
        give_up("writing");
    }
}

static void send_slip(const uint8_t *packet, size_t length)
{
    uint8_t line[64], *end = line;
    *end++ = 0xC0;
    for (size_t i = 0; i < length; i++) {
        if (packet[i] == 0xC0 || packet[i] == 0xDB) {
            *end++ = 0xDB;
            *end++ = packet[i] == 0xC0 ? 0xDC : 0xDD;
        } else {
            *end++ = packet[i];
        }
    }
    *end++ = 0xC0;
    put(line, (size_t)(end - line));
}

/* ISO-TP out: the first frame goes at once, the others when the unit gives way. */
static uint8_t pending[32];
static size_t pending_length, pending_sent;

static void send_frame(uint32_t identifier, const uint8_t *data, size_t length)
{
    struct can_frame frame = {.can_id = identifier, .can_dlc = 8};
    memset(frame.data, 0xCC, 8);
    memcpy(frame.data, data, length);
    put((const uint8_t *)&frame, sizeof frame);
}

static void send_transfer(const uint8_t *packet, size_t length)
{
    uint8_t first[8] = {(uint8_t)(0x10 | length >> 8), (uint8_t)length};
    memcpy(first + 2, packet, 6);
    memcpy(pending, packet, length);
    pending_length = length;
    pending_sent = 6;
    send_frame(0x600 + node, first, 8);
}

static void go_on_with_transfer(void)
{
    for (uint8_t number = 1; pending_sent < pending_length; number++) {
        size_t length = pending_length - pending_sent < 7 ? pending_length - pending_sent : 7;
        uint8_t next[8] = {(uint8_t)(0x20 | (number & 0xF))};
        memcpy(next + 1, pending + pending_sent, length);
        pending_sent += length;
        send_frame(0x600 + node, next, 1 + length);
    }
}

static void acquire(void)
{
    if (now_ms() - last_acquire_ms < AGAIN_MS) {
        return;
    }
    last_acquire_ms = now_ms();
    uint8_t packet[14] = {
        (uint8_t)(0x18 | apid >> 8),
        (uint8_t)apid,
        (uint8_t)(0xC0 | sequence_count >> 8),
        (uint8_t)sequence_count,
        0,
        7,
        0x29,
        8,
        1,
        SOURCE >> 8,
        SOURCE,
        START_ACQUISITION,
    };
    sequence_count = (sequence_count + 1) & 0x3FFF;
    uint16_t crc = crc16(packet, 12);
    packet[12] = (uint8_t)(crc >> 8);
    packet[13] = (uint8_t)crc;
    puts("ACQUIRE");
    if (on_can) {
        send_transfer(packet, sizeof packet);
    } else {
        send_slip(packet, sizeof packet);
    }
}

/* -- what the star tracker says */

static void mode_is(int mode)
{
    if (mode == STANDBY) {
        acquire();
    }
}

static void lose_attitude(const char *why)
{
    if (!safe) {
        printf("SAFE %s\n", why);
    }
    safe = true;
    pointing = false;
    good = 0;
}

static void attitude(bool valid, unsigned frame, const double q[4])
{
    if (!valid) {
        good = 0;
        if (++bad >= BAD_IN_A_ROW && pointing) {
            lose_attitude("invalid");
        }
        return;
    }
    last_valid_ms = now_ms();
    bad = 0;
    printf("ATTITUDE %u %.17g %.17g %.17g %.17g\n", frame, q[0], q[1], q[2], q[3]);
    if (++good >= GOOD_IN_A_ROW && !pointing) {
        pointing = true;
        safe = false;
        puts("POINTING");
    }
}

static void packet_came(const uint8_t *packet, size_t length)
{
    if (length < 22 || crc16(packet, length) != 0) {
        puts("BAD");
        return;
    }
    if ((unsigned)((packet[0] & 7) << 8 | packet[1]) != apid) {
        return;
    }
    int service = packet[7], subservice = packet[8];
    if (service == 130 && subservice == 1 && length >= 70) {
        const double q[4] = {f64(packet + 38), f64(packet + 46), f64(packet + 54), f64(packet + 62)};
        attitude(packet[33], u32(packet + 20), q);
    } else if (service == 3 && subservice == 25 && packet[20] == 1) {
        mode_is(packet[21]); /* housekeeping structure STATUS */
    } else if (service == 5 && packet[20] == 0 && packet[21] == 1) {
        mode_is(STANDBY); /* event BOOT_COMPLETED */
    }
}

static void octet_came(uint8_t octet)
{
    static uint8_t frame[LONGEST_PACKET];
    static size_t length;
    static bool escaped, broken;
    if (octet == 0xC0) {
        if (broken) {
            puts("BAD");
        } else if (length) {
            packet_came(frame, length);
        }
        length = 0;
        escaped = broken = false;
        return;
    }
    if (escaped) {
        broken |= octet != 0xDC && octet != 0xDD;
        octet = octet == 0xDC ? 0xC0 : 0xDB;
        escaped = false;
    } else if (octet == 0xDB) {
        escaped = true;
        return;
    }
    if (length == sizeof frame) {
        broken = true;
    } else {
        frame[length++] = octet;
    }
}

static double i28(uint32_t bits)
{
    return (double)((int32_t)(bits << 4) >> 4) / (1 << 27);
}

static void frame_came(const struct can_frame *frame)
{
    static double q[4];
    static int first_half = -1;
    const uint8_t *data = frame->data;
    unsigned base = frame->can_id & ~0x7FU;
    if ((frame->can_id & 0x7F) != node || frame->can_dlc < 3) {
        return;
    }
    if (base == 0x700) {
        mode_is(data[1]);
    } else if (base == 0x180 || base == 0x280) {
        int half = base == 0x180 ? 0 : 2;
        q[half] = i28(u32(data + 1) >> 4);
        q[half + 1] = i28(u32(data + 4) & 0x0FFFFFFF);
        if (half == 0) {
            first_half = data[0];
        } else if (first_half != data[0]) {
            first_half = -1; /* halves of two images */
        }
    } else if (base == 0x480) {
        if (first_half == data[0]) {
            attitude(data[2] & 0x80, data[0], q);
        }
    } else if (base == 0x580 && data[0] >> 4 == 1) {
        const uint8_t go_on[3] = {0x30, 0, 0};
        send_frame(0x600 + node, go_on, sizeof go_on); /* a packet begins: let it come */
    } else if (base == 0x580 && data[0] == 0x30) {
        go_on_with_transfer();
    }
}

/* -- the loop */

static void open_serial(const char *device)
{
    port = open(device, O_RDWR | O_NOCTTY | O_NONBLOCK);
    struct termios settings;
    if (port < 0 || tcgetattr(port, &settings) < 0) {
        give_up(device);
    }
    cfmakeraw(&settings);
    cfsetspeed(&settings, B115200);
    tcsetattr(port, TCSANOW, &settings);
}

static void open_can(const char *interface)
{
    struct ifreq request = {0};
    struct sockaddr_can address = {.can_family = AF_CAN};
    strncpy(request.ifr_name, interface, IFNAMSIZ - 1);
    port = socket(PF_CAN, SOCK_RAW, CAN_RAW);
    if (port < 0 || ioctl(port, SIOCGIFINDEX, &request) < 0) {
        give_up(interface);
    }
    address.can_ifindex = request.ifr_ifindex;
    if (bind(port, (struct sockaddr *)&address, sizeof address) < 0) {
        give_up(interface);
    }
}

static void take_in(void)
{
    uint8_t bytes[1024];
    struct can_frame frame;
    ssize_t length = on_can ? read(port, &frame, sizeof frame) : read(port, bytes, sizeof bytes);
    if (length < 0 && (errno == EAGAIN || errno == EINTR)) {
        return;
    }
    if (length <= 0) {
        give_up("reading");
    }
    if (on_can) {
        frame_came(&frame);
        return;
    }
    for (ssize_t i = 0; i < length; i++) {
        octet_came(bytes[i]);
    }
}

int main(int argc, char **argv)
{
    on_can = argc == 5 && strcmp(argv[1], "can") == 0;
    if (!on_can && (argc != 4 || strcmp(argv[1], "serial") != 0)) {
        fputs("usage: obc serial DEVICE APID | obc can INTERFACE NODE APID\n", stderr);
        return 2;
    }
    prctl(PR_SET_PDEATHSIG, SIGTERM); /* it ends with the test that started it */
    setvbuf(stdout, NULL, _IOLBF, 0);
    apid = (unsigned)atoi(argv[argc - 1]);
    if (on_can) {
        node = (unsigned)atoi(argv[3]);
        open_can(argv[2]);
    } else {
        open_serial(argv[2]);
    }
    puts("LISTENING");
    for (;;) {
        struct pollfd wait = {.fd = port, .events = POLLIN};
        if (poll(&wait, 1, TICK_MS) > 0) {
            take_in();
        }
        if (pointing && now_ms() - last_valid_ms > SILENCE_MS) {
            lose_attitude("silence");
        }
    }
}
