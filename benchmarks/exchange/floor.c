/* The floor: what a tick's exchange costs in C with the system calls that handctl makes, codec included.
 *
 *   floor local - MOTORS TICKS         a Unix stream socket, records of 72 bytes in one piece, one call a batch
 *   floor packets - MOTORS TICKS       a Unix seqpacket socket, a record a packet, sendmmsg and recvmmsg
 *   floor vcan IFNAME MOTORS TICKS     a raw CAN socket, sendmmsg and recvmmsg, receive stamps asked for
 *
 * The peer is in this process and is not timed. Prints the median of a tick in ns, and the mean CPU time.
 */
#define _GNU_SOURCE
#include <linux/can.h>
#include <linux/can/raw.h>
#include <net/if.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <sys/un.h>
#include <time.h>
#include <unistd.h>

#define MOST 32
static struct canfd_frame records[MOST];
static struct can_frame frames[MOST];
static struct mmsghdr headers[MOST];
static struct iovec vectors[MOST];
static char control[MOST][64];
static volatile double sink;

typedef void (*exchange)(int fd, int motors);

static int64_t now(clockid_t clock) {
    struct timespec t;
    clock_gettime(clock, &t);
    return t.tv_sec * 1000000000LL + t.tv_nsec;
}

static int order(const void *a, const void *b) {
    int64_t x = *(const int64_t *)a, y = *(const int64_t *)b;
    return (x > y) - (x < y);
}

static void encode(unsigned char *data, double torque, double limit) {
    uint64_t word = 0x7FFF7FF000000000ULL | (uint64_t)((torque + limit) * 4095.0 / (2.0 * limit) + 0.5);
    for (int i = 7; i >= 0; i--, word >>= 8)
        data[i] = word & 0xFF;
}

static void decode(const unsigned char *d) {
    double position = (d[1] << 8 | d[2]) * (25.0 / 65535.0) - 12.5;
    double velocity = (d[3] << 4 | d[4] >> 4) * (100.0 / 4095.0) - 50.0;
    double torque = ((d[4] & 15) << 8 | d[5]) * (1.6 / 4095.0) - 0.8;
    sink = position + velocity + torque + (d[6] > d[7] ? d[6] : d[7]);
}

static void prepare(void *store, size_t size, int with_control) {
    for (int i = 0; i < MOST; i++) {
        vectors[i].iov_base = (char *)store + i * size;
        vectors[i].iov_len = size;
        headers[i].msg_hdr.msg_iov = &vectors[i];
        headers[i].msg_hdr.msg_iovlen = 1;
        headers[i].msg_hdr.msg_control = with_control ? control[i] : NULL;
        headers[i].msg_hdr.msg_controllen = with_control ? sizeof control[i] : 0;
    }
}

static int can_socket(const char *name) {
    int fd = socket(PF_CAN, SOCK_RAW, CAN_RAW), on = 1;
    struct sockaddr_can address = {.can_family = AF_CAN, .can_ifindex = if_nametoindex(name)};
    setsockopt(fd, SOL_SOCKET, SO_TIMESTAMPNS, &on, sizeof on);
    return bind(fd, (struct sockaddr *)&address, sizeof address) ? -1 : fd;
}

static void send_local(int fd, int motors) {
    for (int i = 0; i < motors; i++) {
        records[i].can_id = i + 1;
        records[i].len = 8;
        encode(records[i].data, 0.01 * i, 0.8);
    }
    if (send(fd, records, motors * sizeof records[0], MSG_DONTWAIT) < 0)
        exit(3);
}

static void send_packets(int fd, int motors) {
    prepare(records, sizeof records[0], 0);
    for (int i = 0; i < motors; i++) {
        records[i].can_id = i + 1;
        records[i].len = 8;
        encode(records[i].data, 0.01 * i, 0.8);
    }
    if (sendmmsg(fd, headers, motors, MSG_DONTWAIT) != motors)
        exit(10);
}

static void receive_packets(int fd, int motors) {
    prepare(records, sizeof records[0], 0);
    if (recvmmsg(fd, headers, MOST, MSG_DONTWAIT, NULL) != motors)
        exit(11);
    for (int i = 0; i < motors; i++)
        decode(records[i].data);
}

static void answer_packets(int fd, int motors) {
    static char buffer[MOST][72];
    for (int i = 0; i < motors; i++)
        if (recv(fd, buffer[i], 72, 0) != 72)
            exit(12);
    for (int i = 0; i < motors; i++)
        if (send(fd, buffer[i], 72, 0) != 72)
            exit(13);
}

static void receive_local(int fd, int motors) {
    if (recv(fd, records, sizeof records, MSG_DONTWAIT) != motors * (ssize_t)sizeof records[0])
        exit(4);
    for (int i = 0; i < motors; i++)
        decode(records[i].data);
}

static void send_vcan(int fd, int motors) {
    prepare(frames, sizeof frames[0], 0);
    for (int i = 0; i < motors; i++) {
        frames[i].can_id = i + 1;
        frames[i].can_dlc = 8;
        encode(frames[i].data, 0.01 * i, 0.8);
    }
    if (sendmmsg(fd, headers, motors, MSG_DONTWAIT) != motors)
        exit(5);
}

static void receive_vcan(int fd, int motors) {
    prepare(frames, sizeof frames[0], 1);
    if (recvmmsg(fd, headers, MOST, MSG_DONTWAIT, NULL) != motors)
        exit(6);
    for (int i = 0; i < motors; i++)
        decode(frames[i].data);
}

static void answer_vcan(int fd, int motors) {
    struct can_frame frame;
    for (int i = 0; i < motors; i++)
        if (read(fd, &frame, sizeof frame) != sizeof frame)
            exit(7);
    for (int i = 0; i < motors; i++) {
        frame.can_id = 0x11 + i;
        if (write(fd, &frame, sizeof frame) != sizeof frame)
            exit(8);
    }
}

static void answer_local(int fd, int motors) {
    static char buffer[MOST * 72];
    size_t size = motors * 72;
    if (recv(fd, buffer, size, MSG_WAITALL) != (ssize_t)size || send(fd, buffer, size, 0) != (ssize_t)size)
        exit(9);
}

/* What looking at a clock takes, which is not counted. */
static int64_t looking(clockid_t clock) {
    enum { TIMES = 101 };
    static int64_t spans[TIMES];
    for (int i = 0; i < TIMES; i++) {
        int64_t a = now(clock);
        spans[i] = now(clock) - a;
    }
    qsort(spans, TIMES, sizeof *spans, order);
    return spans[TIMES / 2];
}

int main(int argc, char **argv) {
    if (argc != 5)
        return 2;
    int local = !strcmp(argv[1], "local"), packets = !strcmp(argv[1], "packets"), pair[2];
    int motors = atoi(argv[3]), ticks = atoi(argv[4]);
    exchange out = local ? send_local : packets ? send_packets : send_vcan;
    exchange in = local ? receive_local : packets ? receive_packets : receive_vcan;
    exchange peer = local ? answer_local : packets ? answer_packets : answer_vcan;
    if ((local || packets) && socketpair(AF_UNIX, local ? SOCK_STREAM : SOCK_SEQPACKET, 0, pair))
        return 1;
    if (!local && !packets && ((pair[0] = can_socket(argv[2])) < 0 || (pair[1] = can_socket(argv[2])) < 0))
        return 1;
    int64_t *spans = calloc(ticks, sizeof *spans), cpu = 0;
    int64_t look[] = {looking(CLOCK_THREAD_CPUTIME_ID), looking(CLOCK_MONOTONIC)};
    for (int k = 0; k < 2 * ticks; k++) { /* by one clock at a time */
        clockid_t clock = k < ticks ? CLOCK_THREAD_CPUTIME_ID : CLOCK_MONOTONIC;
        int64_t a = now(clock);
        out(pair[0], motors);
        int64_t span = now(clock) - a;
        peer(pair[1], motors);
        a = now(clock);
        in(pair[0], motors);
        span += now(clock) - a - 2 * look[k >= ticks];
        if (k < ticks)
            cpu += span;
        else
            spans[k - ticks] = span;
    }
    qsort(spans, ticks, sizeof *spans, order);
    printf("%lld %lld\n", (long long)spans[ticks / 2], (long long)(cpu / ticks));
    return 0;
}
