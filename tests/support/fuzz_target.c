/* SPDX-License-Identifier: Apache-2.0
 *
 * Packets by chance for the C target: any bytes, good packets with bytes changed, good ones with any values. After every
 * tick the outputs are finite and within capacity, rate limit, acceleration and jerk, else it aborts.
 * Prints how many packets became what, and at how many ticks the target was armed.
 */
#include "abrace_target.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define GROUPS 2
#define LENGTH (20 + 8 * (GROUPS + 1) + 4)

static uint64_t state = 88172645463325252u;

static uint32_t chance(uint32_t below)
{
    state ^= state << 13;
    state ^= state >> 7;
    state ^= state << 17;
    return (uint32_t)(state >> 32) % below;
}

static void put(uint8_t *at, uint64_t value, int bytes)
{
    for (int i = 0; i < bytes; i++)
        at[i] = (uint8_t)(value >> 8 * i);
}

static void sign(uint8_t *packet)
{
    uint32_t crc = UINT32_MAX;
    for (int i = 0; i < LENGTH - 4; i++) {
        crc ^= packet[i];
        for (int bit = 0; bit < 8; bit++)
            crc = crc & 1u ? crc >> 1 ^ 0xEDB88320u : crc >> 1;
    }
    put(packet + LENGTH - 4, ~crc, 4);
}

static uint64_t bits(double value)
{
    uint64_t found;
    memcpy(&found, &value, sizeof found);
    return found;
}

static uint64_t any_double(void)
{
    switch (chance(15000)) {
    case 0:
        return bits(NAN);
    case 1:
        return bits(-INFINITY);
    case 2:
        return state; /* any bits */
    default:
        if (chance(100) == 0)
            return bits(chance(2) ? 1e308 : -0.0);
        return bits(3000.0 * (chance(2001) / 1000.0 - 1.0));
    }
}

static void good_packet(uint8_t *packet, const abrace_target *target, uint32_t counter)
{
    static const uint32_t wanted[] = {ABRACE_FOLLOW, ABRACE_HOLD_ZERO};
    const uint32_t next = target->last_arm + 1;
    put(packet, ABRACE_COMMAND_MAGIC, 4);
    put(packet + 4, ABRACE_VERSION, 4);
    put(packet + 8, chance(5000) ? counter : chance(UINT32_MAX), 4);
    put(packet + 12, target->state == ABRACE_ARMED && chance(5000) ? target->last_arm : next, 4);
    put(packet + 16, target->state != ABRACE_ARMED ? 1 : chance(2000) ? wanted[chance(8) == 0] : chance(4), 4);
    for (int i = 0; i <= GROUPS; i++)
        put(packet + 20 + 8 * i, target->state == ABRACE_ARMED ? any_double() : 0, 8);
    sign(packet);
}

static void check(int good, const char *what)
{
    if (!good) {
        fprintf(stderr, "%s\n", what);
        abort();
    }
}

int main(int count, char **arguments)
{
    const abrace_target_settings settings = {.period = 0.002, .life_time = 0.05, .ramp_time = 0.1, .groups = GROUPS,
        .capacity = {1000.0, 500.0}, .rate_limit = {1e5, 5e4}, .channels = 3, .table_driven = 1,
        .table_acceleration = 10.0, .table_jerk = 2000.0, .table_measured = 1, .last_arm = UINT32_MAX - 5};
    static const double most[] = {1000.0, 500.0, 10.0}, step[] = {200.0, 100.0, 4.0};
    static const double measured[] = {1.0, 2.0, 3.0};
    const long packets = count > 1 ? atol(arguments[1]) : 1000000;
    unsigned long became[8] = {0}, armed = 0;
    uint32_t counter = 0;
    abrace_target target;
    check(abrace_target_init(&target, &settings) == 0, "settings");
    for (long number = 0; number < packets; number++) {
        const uint32_t kind = chance(10);
        size_t length = LENGTH;
        /* of exactly this size, so that a byte read beyond it is found */
        uint8_t *packet;
        if (kind == 0 && chance(2))
            length = chance(200);
        packet = malloc(length ? length : 1);
        if (packet == NULL)
            return 1;
        if (kind == 0) {
            for (size_t i = 0; i < length; i++)
                packet[i] = (uint8_t)chance(256);
            if (length == LENGTH)
                sign(packet);
        } else {
            good_packet(packet, &target, ++counter);
            if (kind < 4)
                packet[chance(LENGTH)] ^= (uint8_t)(1u << chance(8));
            if (kind == 3 && chance(20) == 0)
                sign(packet);
        }
        became[abrace_target_receive(&target, packet, length)]++;
        free(packet);
        if (chance(3) == 0) {
            double before[GROUPS + 1];
            size_t size = 40 + 8 * (GROUPS + 2 + 3);
            uint8_t *sample = malloc(size);
            if (sample == NULL)
                return 1;
            memcpy(before, target.applied, sizeof before);
            if (chance(2000) == 0)
                abrace_target_stop(&target, 1u << chance(32));
            abrace_target_tick(&target, chance(50) ? 1 : chance(50) ? chance(8) : chance(2) ? chance(40) : chance(UINT32_MAX));
            armed += target.state == ABRACE_ARMED;
            for (int i = 0; i <= GROUPS; i++) {
                check(isfinite(target.applied[i]) && fabs(target.applied[i]) <= most[i], "beyond its greatest value");
                check(fabs(target.applied[i] - before[i]) <= step[i] * (1.0 + 1e-12), "a step beyond its limit");
                check(target.state != ABRACE_DISARMED || target.applied[i] == 0.0, "an output without power");
            }
            check(isfinite(target.velocity) && isfinite(target.displacement), "set values of the table");
            check(target.power == (target.state != ABRACE_DISARMED), "power");
            check(abrace_target_sample(&target, state, 0.01, measured, sample) == size, "length of a sample");
            free(sample);
        }
    }
    for (int i = 0; i < 8; i++)
        printf("%lu ", became[i]);
    printf("%lu\n", armed);
    return 0;
}
