/* SPDX-License-Identifier: Apache-2.0
 *
 * The target on Linux: ticks by the system's clock, packets by UDP. `read_sensors`, `own_limits` and `write_outputs` are
 * a laboratory's to fill in: here nothing is connected, and load cells read the force that is applied.
 *
 *     cc -std=c99 -O2 port_linux_udp.c abrace_target.c -lm -o target
 *     ./target 15000 192.168.7.1 15001 channels=-------11w capacity=24516 rate_limit=5e6
 *
 * Arguments: the port where commands come, address and port of abrace (`local_port` of its device file), and NAME=VALUE for
 * the names in `numbers` below; groups separated by commas. `channels` has a character for each value of a sample: 1 to 8
 * the load cell of a group, w the table's acceleration, - zero. While it runs it prints nothing. SIGTERM and SIGINT are a
 * stop: the program ends when everything is at rest.
 */
#define _POSIX_C_SOURCE 200809L
#include "abrace_target.h"

#include <arpa/inet.h>
#include <errno.h>
#include <sched.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/socket.h>
#include <time.h>

#define STOPPED_BY_SIGNAL (1u << 16)
#define MOST_PACKETS 20 /* in a tick, so that a flood of packets does not hold it up */

static abrace_target_settings settings = {.period = 0.002, .life_time = 0.05, .ramp_time = 0.1};
static const char *channels = "";
static double priority = 0.0; /* of SCHED_FIFO, 1 to 99; 0: as any program */
static double table_driven = 0.0, table_measured = 0.0;

static const struct {
    const char *name;
    double *values;
    uint32_t most;
} numbers[] = {
    {"period", &settings.period, 1},
    {"life_time", &settings.life_time, 1},
    {"ramp_time", &settings.ramp_time, 1},
    {"capacity", settings.capacity, ABRACE_MOST_GROUPS},
    {"rate_limit", settings.rate_limit, ABRACE_MOST_GROUPS},
    {"table_driven", &table_driven, 1},
    {"table_measured", &table_measured, 1},
    {"table_acceleration", &settings.table_acceleration, 1},
    {"table_jerk", &settings.table_jerk, 1},
    {"priority", &priority, 1},
};

/* ---- the laboratory's ---- */

static void read_sensors(const abrace_target *target, double measured[], double *table)
{
    for (uint32_t i = 0; i < settings.channels; i++) {
        const char is = channels[i];
        measured[i] = 0.0;
        if (is == 'w')
            measured[i] = target->applied[settings.groups];
        else if (is >= '1' && is < '1' + (int)settings.groups)
            measured[i] = target->applied[is - '1'];
    }
    *table = target->displacement;
}

static uint32_t own_limits(const double measured[], double table)
{
    (void)measured;
    (void)table;
    return 0;
}

static void write_outputs(const abrace_target *target)
{
    (void)target;
}

/* ---- clock and network ---- */

static int network;
static uint64_t due; /* ns, of the last tick */
static volatile sig_atomic_t signalled;

static void note_signal(int number)
{
    (void)number;
    signalled = 1;
}

static uint64_t now(void)
{
    struct timespec time;
    clock_gettime(CLOCK_MONOTONIC, &time);
    return (uint64_t)time.tv_sec * 1000000000u + (uint64_t)time.tv_nsec;
}

/* Wait for the next tick; the number of periods since the last one. */
static uint32_t wait_for_tick(void)
{
    const uint64_t period = (uint64_t)(settings.period * 1e9 + 0.5);
    const uint64_t next = due + period;
    const struct timespec until = {(time_t)(next / 1000000000u), (long)(next % 1000000000u)};
    uint64_t woken;
    while (clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &until, NULL) == EINTR)
        ;
    woken = now();
    const uint64_t ticks = woken > next ? 1 + (woken - next) / period : 1;
    due += ticks * period;
    return ticks < UINT32_MAX ? (uint32_t)ticks : UINT32_MAX;
}

static size_t receive_packet(uint8_t *packet, size_t most)
{
    ssize_t length;
    do
        length = recv(network, packet, most, MSG_DONTWAIT | MSG_TRUNC);
    while (length < 0 && errno == ECONNREFUSED); /* nobody listened when a sample was sent */
    return length > 0 ? (size_t)length : 0;
}

/* A socket for packets between our port and abrace's alone; -1: there is none. */
static int connected(const char *port, const char *address, const char *abrace_port)
{
    struct sockaddr_in ours = {.sin_family = AF_INET, .sin_port = htons((uint16_t)atoi(port))};
    struct sockaddr_in abrace = {.sin_family = AF_INET, .sin_port = htons((uint16_t)atoi(abrace_port))};
    const int descriptor = socket(AF_INET, SOCK_DGRAM, 0);
    if (inet_pton(AF_INET, address, &abrace.sin_addr) != 1 ||
        bind(descriptor, (const struct sockaddr *)&ours, sizeof ours) != 0 ||
        connect(descriptor, (const struct sockaddr *)&abrace, sizeof abrace) != 0)
        return -1;
    return descriptor;
}

/* ---- the command line ---- */

static int set(const char *argument)
{
    const char *value = strchr(argument, '=');
    if (value == NULL)
        return 0;
    const size_t length = (size_t)(value++ - argument);
    if (length == 8 && strncmp(argument, "channels", length) == 0) {
        channels = value;
        settings.channels = (uint32_t)strlen(value);
        return 1;
    }
    for (size_t i = 0; i < sizeof numbers / sizeof *numbers; i++) {
        if (strlen(numbers[i].name) != length || strncmp(argument, numbers[i].name, length) != 0)
            continue;
        for (uint32_t count = 0; count < numbers[i].most; count++) {
            char *end;
            numbers[i].values[count] = strtod(value, &end);
            if (numbers[i].values == settings.capacity)
                settings.groups = count + 1;
            if (end == value || (*end != ',' && *end != '\0'))
                return 0;
            if (*end == '\0')
                return 1;
            value = end + 1;
        }
    }
    return 0;
}

int main(int count, char **arguments)
{
    static abrace_target target;
    static double measured[ABRACE_MOST_CHANNELS];
    static uint8_t packet[ABRACE_LONGEST_PACKET];
    struct sigaction action;
    double table;
    if (count < 4) {
        fprintf(stderr, "usage: %s PORT ABRACE_ADDRESS ABRACE_PORT NAME=VALUE ...\n", arguments[0]);
        return 2;
    }
    for (int i = 4; i < count; i++)
        if (!set(arguments[i])) {
            fprintf(stderr, "%s: expected NAME=VALUE, of a name and with numbers that there are\n", arguments[i]);
            return 2;
        }
    settings.table_driven = table_driven != 0.0;
    settings.table_measured = table_measured != 0.0;
    settings.last_arm = (uint32_t)time(NULL);
    if (abrace_target_init(&target, &settings) != 0) {
        fprintf(stderr, "settings that make no sense: see abrace_target_settings\n");
        return 2;
    }
    network = connected(arguments[1], arguments[2], arguments[3]);
    if (network < 0) {
        perror("no socket with this port and address");
        return 2;
    }
    if (priority > 0.0) {
        const struct sched_param fifo = {.sched_priority = (int)priority};
        if (mlockall(MCL_CURRENT | MCL_FUTURE) != 0 || sched_setscheduler(0, SCHED_FIFO, &fifo) != 0) {
            perror("priority");
            return 2;
        }
    }
    memset(&action, 0, sizeof action);
    action.sa_handler = note_signal;
    sigaction(SIGTERM, &action, NULL);
    sigaction(SIGINT, &action, NULL);
    for (due = now(); !signalled || target.state != ABRACE_DISARMED;) {
        const uint32_t ticks = wait_for_tick();
        uint32_t cause;
        size_t length;
        read_sensors(&target, measured, &table);
        cause = own_limits(measured, table) | (signalled ? STOPPED_BY_SIGNAL : 0);
        if (cause != 0)
            abrace_target_stop(&target, cause);
        for (int i = 0; i < MOST_PACKETS && (length = receive_packet(packet, sizeof packet)) != 0; i++)
            abrace_target_receive(&target, packet, length);
        abrace_target_tick(&target, ticks);
        write_outputs(&target);
        length = abrace_target_sample(&target, due, table, measured, packet);
        (void)!send(network, packet, length, MSG_DONTWAIT); /* where it fails, abrace misses a sample, and stops */
    }
    return 0;
}
