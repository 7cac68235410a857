/* SPDX-License-Identifier: Apache-2.0 */
#include "abrace_target.h"

#include <math.h>
#include <string.h>

static const double PI = 3.14159265358979323846;
static const double BRAKING_TIME = 0.05; /* s, with which a slow table comes to rest */
static const double STILL = 1e-6;        /* m/s, below which a braking table is at rest */
static const double DRIFT = 0.01;        /* m/s: a table whose command was zero for 1 s is not meant to move so slowly */

static double within(double value, double least, double greatest)
{
    return value > greatest ? greatest : value < least ? least : value;
}

static uint32_t whole_ticks(double time, double period)
{
    return (uint32_t)(time / period * (1.0 + 1e-12));
}

static int positive(double value)
{
    return isfinite(value) && value > 0.0;
}

int abrace_target_init(abrace_target *target, const abrace_target_settings *settings)
{
    const abrace_target_settings *s = settings;
    int good = s->groups >= 1 && s->groups <= ABRACE_MOST_GROUPS && s->channels <= ABRACE_MOST_CHANNELS &&
               s->table_driven <= 1 && s->table_measured <= 1 && s->period >= 1e-5 && s->period <= 0.02 &&
               s->life_time >= 2.0 * s->period && s->life_time <= 1.0 && s->ramp_time >= s->period &&
               s->ramp_time <= 1.0;
    for (uint32_t i = 0; good && i < s->groups; i++)
        good = positive(s->capacity[i]) && positive(s->rate_limit[i]);
    if (!good || (s->table_driven && !(positive(s->table_acceleration) && positive(s->table_jerk))))
        return 1;
    memset(target, 0, sizeof *target);
    target->settings = *settings;
    target->causes = ABRACE_RESTARTED;
    target->last_arm = settings->last_arm;
    return 0;
}

/* ---- commands ---- */

static void begin_to_stop(abrace_target *target, uint32_t cause)
{
    if (target->state == ABRACE_ARMED) {
        target->state = ABRACE_STOPPING;
        target->stopping = 0;
        memcpy(target->ramp_from, target->applied, sizeof target->ramp_from);
    }
    if (target->state == ABRACE_STOPPING)
        target->causes |= cause;
}

void abrace_target_stop(abrace_target *target, uint32_t cause)
{
    begin_to_stop(target, cause);
    target->causes |= cause;
    target->blocked = 1;
}

/* The number that arms the target next; 0 never does. */
static uint32_t next_arm(const abrace_target *target)
{
    return target->last_arm == UINT32_MAX ? 1 : target->last_arm + 1;
}

static int all_finite(const double values[], uint32_t count)
{
    for (uint32_t i = 0; i < count; i++)
        if (!isfinite(values[i]))
            return 0;
    return 1;
}

static int follows(const abrace_target *target)
{
    return target->state == ABRACE_ARMED && target->wanted == ABRACE_FOLLOW;
}

int abrace_target_command(abrace_target *target, uint32_t counter, uint32_t arm, uint32_t wanted,
                          const double outputs[])
{
    const abrace_target_settings *s = &target->settings;
    const uint32_t ahead = counter - target->counter; /* modulo 2^32 */
    if (target->heard && ahead == 0)
        return ABRACE_REPEATED;
    if (target->state == ABRACE_ARMED && ahead > UINT32_MAX / 2)
        return ABRACE_OLD; /* not armed: abrace may have been restarted, and count from any number */
    target->counter = counter;
    target->heard = 1;
    if (wanted > ABRACE_FOLLOW || !all_finite(outputs, s->groups + 1)) {
        begin_to_stop(target, ABRACE_BAD_COMMAND);
        return ABRACE_NOT_FINITE;
    }
    if (wanted == ABRACE_SAFE) {
        if (target->state == ABRACE_ARMED) /* abrace answers a stop of the target's own with it: no further cause */
            begin_to_stop(target, ABRACE_ASKED);
    } else if (target->state == ABRACE_ARMED) {
        if (arm != target->last_arm) {
            begin_to_stop(target, ABRACE_OTHER_ARM);
            return ABRACE_REFUSED;
        }
    } else {
        /* the only way to follow: at rest, asked for zero, with the next arm number, and no cause against it */
        if (target->state != ABRACE_DISARMED || wanted != ABRACE_HOLD_ZERO || arm != next_arm(target) ||
            target->blocked)
            return ABRACE_REFUSED;
        target->state = ABRACE_ARMED;
        target->last_arm = arm;
        target->causes = 0;
    }
    for (uint32_t i = 0; i < s->groups; i++)
        target->command[i] = within(outputs[i], -s->capacity[i], s->capacity[i]);
    target->command[s->groups] = within(outputs[s->groups], -s->table_acceleration, s->table_acceleration);
    target->wanted = wanted;
    target->obeyed = counter;
    target->silent = 0;
    return ABRACE_OBEYED;
}

int abrace_target_force(abrace_target *target, const double force[], double margin)
{
    const abrace_target_settings *s = &target->settings;
    if (!follows(target))
        return ABRACE_REFUSED;
    if (!all_finite(force, s->groups) || !isfinite(margin)) {
        begin_to_stop(target, ABRACE_BAD_COMMAND);
        return ABRACE_NOT_FINITE;
    }
    for (uint32_t i = 0; i < s->groups; i++) {
        const double command = target->command[i], most = s->capacity[i], reach = fabs(margin) * most;
        target->local_force[i] = within(within(force[i], command - reach, command + reach), -most, most);
    }
    target->local = 1;
    return ABRACE_OBEYED;
}

/* ---- outputs ---- */

/* The next acceleration of a table that comes to rest: in proportion to its velocity, within acceleration and jerk. */
static double braking(const abrace_target *target, double jerk_step)
{
    const abrace_target_settings *s = &target->settings;
    const double now = target->applied[s->groups], speed = fabs(target->velocity);
    double most = s->table_acceleration;
    most = within(speed / BRAKING_TIME, 0.0, most);
    most = within(sqrt(s->table_jerk * speed), 0.0, most); /* so that the jerk brings it to zero in time */
    if (speed < STILL && fabs(now) < STILL / BRAKING_TIME)
        return 0.0;
    return within(target->velocity > 0.0 ? -most : most, now - jerk_step, now + jerk_step);
}

/* Advance the table's set values: its acceleration was held in ticks that were missed, and is linear in the last one. */
static void move_table(abrace_target *target, uint32_t ticks)
{
    const abrace_target_settings *s = &target->settings;
    double *acceleration = &target->applied[s->groups];
    const int following = follows(target);
    const double before = *acceleration, step = s->table_jerk * s->period;
    const double held = (ticks - 1) * s->period, period = s->period;
    target->displacement += held * (target->velocity + held / 2.0 * before);
    target->velocity += held * before;
    *acceleration = following ? within(target->command[s->groups], before - step, before + step)
                              : braking(target, step);
    target->displacement += period * (target->velocity + period / 6.0 * (2.0 * before + *acceleration));
    target->velocity += period / 2.0 * (before + *acceleration);
    target->still = before != 0.0 || *acceleration != 0.0 ? 0 : target->still + 1;
    if (*acceleration == 0.0 && fabs(target->velocity) < (following ? DRIFT : STILL) &&
        (!following || target->still * period >= 1.0))
        target->velocity = 0.0;
}

static int at_rest(const abrace_target *target)
{
    for (uint32_t i = 0; i <= target->settings.groups; i++)
        if (target->applied[i] != 0.0)
            return 0;
    return target->velocity == 0.0;
}

/* The share of the force that is left: half a cosine over the ramp time. */
static double ramp_share(const abrace_target *target)
{
    const uint32_t ramp = whole_ticks(target->settings.ramp_time, target->settings.period);
    return target->stopping >= ramp ? 0.0 : (1.0 + cos(PI * target->stopping / ramp)) / 2.0;
}

void abrace_target_tick(abrace_target *target, uint32_t ticks)
{
    const abrace_target_settings *s = &target->settings;
    const uint32_t life = whole_ticks(s->life_time, s->period);
    if (ticks == 0)
        ticks = 1;
    target->ticks += ticks;
    if (target->state == ABRACE_STOPPING && at_rest(target))
        target->state = ABRACE_DISARMED; /* a tick after the outputs are zero */
    if (target->state == ABRACE_ARMED && ticks > life)
        begin_to_stop(target, ABRACE_MISSED_TICKS);
    if (target->state == ABRACE_ARMED && (target->silent += ticks) > life)
        begin_to_stop(target, ABRACE_NO_COMMANDS);
    if (target->state == ABRACE_STOPPING)
        target->stopping = ticks > UINT32_MAX - target->stopping ? UINT32_MAX : target->stopping + ticks;
    for (uint32_t i = 0; i < s->groups; i++) {
        const double before = target->applied[i], step = s->rate_limit[i] * s->period;
        double force = 0.0;
        if (follows(target))
            force = target->local ? target->local_force[i] : target->command[i];
        else if (target->state == ABRACE_STOPPING)
            force = target->ramp_from[i] * ramp_share(target);
        target->applied[i] = within(force, before - step, before + step);
    }
    if (s->table_driven)
        move_table(target, ticks > life ? life : ticks); /* what a table does for longer is not known */
    target->power = target->state != ABRACE_DISARMED;
    target->applied_counter = target->obeyed;
    target->blocked = target->local = 0;
}

/* ---- packets: little-endian, without gaps, a CRC-32 at the end (that of zlib, Ethernet and PNG) ---- */

static uint32_t crc32(const uint8_t *bytes, size_t length)
{
    uint32_t crc = UINT32_MAX;
    for (size_t i = 0; i < length; i++) {
        crc ^= bytes[i];
        for (int bit = 0; bit < 8; bit++)
            crc = crc & 1u ? crc >> 1 ^ 0xEDB88320u : crc >> 1;
    }
    return ~crc;
}

static uint8_t *put(uint8_t *at, uint64_t value, int bytes)
{
    for (int i = 0; i < bytes; i++)
        *at++ = (uint8_t)(value >> 8 * i);
    return at;
}

static uint8_t *put_double(uint8_t *at, double value)
{
    uint64_t bits;
    memcpy(&bits, &value, sizeof bits);
    return put(at, bits, 8);
}

static uint64_t get(const uint8_t *at, int bytes)
{
    uint64_t value = 0;
    for (int i = 0; i < bytes; i++)
        value |= (uint64_t)at[i] << 8 * i;
    return value;
}

int abrace_target_receive(abrace_target *target, const uint8_t *packet, size_t length)
{
    const uint32_t count = target->settings.groups + 1;
    double outputs[ABRACE_MOST_GROUPS + 1];
    if (length != 20 + 8 * count + 4)
        return ABRACE_WRONG_LENGTH;
    if (crc32(packet, length - 4) != get(packet + length - 4, 4))
        return ABRACE_WRONG_CRC;
    if (get(packet, 4) != ABRACE_COMMAND_MAGIC || get(packet + 4, 4) != ABRACE_VERSION)
        return ABRACE_WRONG_CONSTANT;
    for (uint32_t i = 0; i < count; i++) {
        const uint64_t bits = get(packet + 20 + 8 * i, 8);
        memcpy(&outputs[i], &bits, sizeof bits);
    }
    return abrace_target_command(target, (uint32_t)get(packet + 8, 4), (uint32_t)get(packet + 12, 4),
                                 (uint32_t)get(packet + 16, 4), outputs);
}

size_t abrace_target_sample(abrace_target *target, uint64_t time, double table, const double measured[],
                            uint8_t *packet)
{
    const abrace_target_settings *s = &target->settings;
    uint8_t *at = packet;
    at = put(at, ABRACE_SAMPLE_MAGIC, 4);
    at = put(at, ABRACE_VERSION, 4);
    at = put(at, target->ticks, 4);
    at = put(at, time, 8);
    at = put(at, target->state, 4);
    at = put(at, target->causes, 4);
    at = put(at, target->last_arm, 4);
    at = put(at, target->applied_counter, 4);
    for (uint32_t i = 0; i <= s->groups; i++)
        at = put_double(at, target->applied[i]);
    if (s->table_measured)
        at = put_double(at, table);
    for (uint32_t i = 0; i < s->channels; i++)
        at = put_double(at, measured[i]);
    at = put(at, crc32(packet, (size_t)(at - packet)), 4);
    if (s->table_measured && target->state == ABRACE_DISARMED && isfinite(table))
        target->displacement = table; /* the set value begins where the table stands */
    return (size_t)(at - packet);
}
