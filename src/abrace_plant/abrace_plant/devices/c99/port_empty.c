/* SPDX-License-Identifier: Apache-2.0
 *
 * The empty port: copy it, and fill in what is marked TODO. As it is, it compiles, waits for nothing and moves nothing.
 * port_linux_udp.c is the same, filled in for Linux.
 *
 *     cc -std=c99 -O2 port_empty.c abrace_target.c -lm
 */
#include "abrace_target.h"

static const abrace_target_settings settings = {
    .period = 0.002, /* s: `sample_rate` of the rig file */
    .life_time = 0.05,
    .ramp_time = 0.1,
    .groups = 1,
    .capacity = {24516.0},         /* N: of the rig file, for each group */
    .rate_limit = {5e6},           /* N/s: what the valve survives */
    .channels = 10,                /* values of a sample, in the order of the layout file */
    .table_driven = 1,             /* 0: the table has a controller of its own */
    .table_acceleration = 10.0,    /* m/s^2 */
    .table_jerk = 2000.0,          /* m/s^3 */
    .table_measured = 1,           /* 0: nobody measures where the table is */
};

/* TODO: the number with which arming begins: another one at each start, as the seconds of a clock. */
static uint32_t number_of_this_start(void)
{
    return 0;
}

/* TODO: wait for the next tick of the hardware's clock. Returns how many periods have gone by since the last tick: 1, or
 * more where ticks were missed. Writes the time of this tick by a clock that nobody sets [ns]. */
static uint32_t wait_for_tick(uint64_t *time)
{
    *time += 2000000;
    return 1;
}

/* TODO: copy the next packet that abrace's computer has sent to `packet`, and return its length; 0: there is none. Does
 * not wait. A packet from another address is not given. */
static size_t receive_packet(uint8_t *packet, size_t most)
{
    (void)packet;
    (void)most;
    return 0;
}

/* TODO: send a packet to abrace's computer. Does not wait; that it cannot be sent is no error. */
static void send_packet(const uint8_t *packet, size_t length)
{
    (void)packet;
    (void)length;
}

/* TODO: read all converters at this instant, in SI units or as the calibration file of abrace converts them, and the
 * displacement of the table [m]. */
static void read_sensors(double measured[], double *table)
{
    for (uint32_t i = 0; i < settings.channels; i++)
        measured[i] = 0.0;
    *table = 0.0;
}

/* TODO: what stops this target, 0: nothing. Stroke, force, pressure, temperature: ABRACE_OWN_LIMIT, or a bit of your own
 * from 1 << 16. The contact of the emergency stop: ABRACE_EMERGENCY_STOP; its circuit takes the power away by itself. */
static uint32_t own_limits(const double measured[], double table)
{
    (void)measured;
    (void)table;
    return 0;
}

/* TODO: put out applied[0] to applied[groups - 1], the force of ONE brace of each group [N]; the table's set value:
 * applied[groups] (acceleration), velocity or displacement, whichever its controller takes; and power: 1 opens the valve
 * and releases the brake, 0 the other way. What loses its power must come to rest. */
static void write_outputs(const abrace_target *target)
{
    (void)target;
}

int main(void)
{
    static abrace_target target;
    static double measured[ABRACE_MOST_CHANNELS];
    static uint8_t packet[ABRACE_LONGEST_PACKET];
    abrace_target_settings mine = settings;
    double table = 0.0;
    uint64_t time = 0;
    mine.last_arm = number_of_this_start();
    if (abrace_target_init(&target, &mine) != 0)
        return 2;
    for (;;) {
        const uint32_t ticks = wait_for_tick(&time);
        uint32_t cause;
        size_t length;
        int packets = 0;
        read_sensors(measured, &table);
        if ((cause = own_limits(measured, table)) != 0)
            abrace_target_stop(&target, cause);
        /* not more than a few, so that a flood of packets does not hold up the tick */
        while (packets++ < 20 && (length = receive_packet(packet, sizeof packet)) != 0)
            abrace_target_receive(&target, packet, length);
        abrace_target_tick(&target, ticks);
        write_outputs(&target);
        length = abrace_target_sample(&target, time, table, measured, packet);
        send_packet(packet, length);
    }
}
