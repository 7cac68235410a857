/* SPDX-License-Identifier: Apache-2.0
 *
 * The target of abrace in C99: the program beside the actuators that follows the commands of abrace's node
 * `sensor_bridge`, and has the last word. No heap, no library but <math.h> and <string.h>; docs/target.md explains it.
 *
 *     abrace_target_init(&target, &settings);                  once
 *     at every tick of the hardware:
 *         if (own limit or emergency stop)
 *             abrace_target_stop(&target, cause);
 *         abrace_target_receive(&target, packet, length);      for each packet that has come, in its order
 *         abrace_target_tick(&target, ticks);                  1, or more where ticks were missed
 *         output target.applied[], target.power
 *         length = abrace_target_sample(&target, time, table, measured, packet), and send it
 *
 * All values are SI units. A force is that of ONE brace of a group, positive when its actuator extends and pushes.
 */
#ifndef ABRACE_TARGET_H
#define ABRACE_TARGET_H

#include <stddef.h>
#include <stdint.h>

#define ABRACE_MOST_GROUPS 8
#define ABRACE_MOST_CHANNELS 64
#define ABRACE_LONGEST_PACKET (36 + 8 * (ABRACE_MOST_GROUPS + 2 + ABRACE_MOST_CHANNELS) + 4)
#define ABRACE_VERSION 2u
#define ABRACE_SAMPLE_MAGIC 0x41425231u
#define ABRACE_COMMAND_MAGIC 0x41425232u

/* State of the target. */
enum {
    ABRACE_DISARMED = 0, /* outputs are zero, no power: the valve is shut or the brake acts */
    ABRACE_ARMED = 1,    /* power; outputs follow the commands that have the arm number */
    ABRACE_STOPPING = 2  /* power; outputs go to zero along the target's own ramp, then DISARMED */
};

/* What abrace wants of the target. */
enum {
    ABRACE_SAFE = 0,      /* stop: ramp, then DISARMED */
    ABRACE_HOLD_ZERO = 1, /* outputs at zero; arms the target if the arm number is the next one */
    ABRACE_FOLLOW = 2     /* outputs follow the commands, if the target is armed with this arm number */
};

/* Why the target has stopped: bits that stay until it is armed again. Bits 16 to 31 are the laboratory's own. */
enum {
    ABRACE_RESTARTED = 1,       /* the target's program was started, and has not been armed since */
    ABRACE_ASKED = 2,           /* abrace asked for it (SAFE) */
    ABRACE_NO_COMMANDS = 4,     /* no new command for the life time */
    ABRACE_OTHER_ARM = 8,       /* a command with another arm number than the one that it is armed with */
    ABRACE_BAD_COMMAND = 16,    /* a value that is not finite, or a wanted state that there is not */
    ABRACE_MISSED_TICKS = 32,   /* the target itself missed its ticks for longer than the life time */
    ABRACE_OWN_LIMIT = 64,      /* a limit of the laboratory's own: stroke, force, pressure */
    ABRACE_EMERGENCY_STOP = 128 /* the emergency stop */
};

/* What has become of a command. */
enum {
    ABRACE_OBEYED = 0,
    ABRACE_REFUSED = 1, /* not armed, or not with this number; or an arm number that is not the next one */
    ABRACE_REPEATED = 2,
    ABRACE_OLD = 3,
    ABRACE_NOT_FINITE = 4, /* or a wanted state that there is not */
    ABRACE_WRONG_LENGTH = 5,
    ABRACE_WRONG_CRC = 6,
    ABRACE_WRONG_CONSTANT = 7 /* of the layout, or of its version */
};

typedef struct {
    double period;                          /* s, of a tick: at most 0.02 */
    double life_time;                       /* s without a new command, after which it stops: two periods to 1 s */
    double ramp_time;                       /* s, of the force's ramp to zero; longer where the rate limit needs it */
    double capacity[ABRACE_MOST_GROUPS];    /* N, greatest force of one brace of each group */
    double rate_limit[ABRACE_MOST_GROUPS];  /* N/s, of the force of one brace of each group */
    double table_acceleration, table_jerk;  /* m/s^2, m/s^3: greatest ones, where abrace drives the table */
    uint32_t groups, channels;              /* of braces; of measured values in a sample */
    uint32_t table_driven, table_measured;  /* 0 or 1: the table follows abrace; its displacement is in the sample */
    uint32_t last_arm;                      /* before the first arming: another number at each start, as of a clock */
} abrace_target_settings;

typedef struct {
    abrace_target_settings settings;
    /* to be output after each tick */
    double applied[ABRACE_MOST_GROUPS + 1]; /* N of one brace of each group, then the table's acceleration [m/s^2] */
    double velocity, displacement;          /* m/s, m: the table's set values, integrated from its acceleration */
    uint32_t power;                         /* 1: valve open, brake released */
    uint32_t state, causes;                 /* as above */
    uint32_t last_arm;                      /* the arm number that was accepted last */
    uint32_t ticks;                         /* counted, with those that were missed; wraps */
    uint32_t applied_counter;               /* counter of the last command that was obeyed, up to this tick */
    /* its own */
    uint32_t counter, heard;                /* of the last command, obeyed or not; whether there was one */
    uint32_t obeyed, wanted;                /* counter of the last command that was obeyed, and what it wants */
    uint32_t silent, stopping, still;       /* ticks since then; since the stop; of a table whose command is zero */
    uint32_t blocked;                       /* a cause of its own keeps it disarmed at this tick */
    double command[ABRACE_MOST_GROUPS + 1], ramp_from[ABRACE_MOST_GROUPS];
    double local_force[ABRACE_MOST_GROUPS]; /* of a law on the target */
    uint32_t local;                         /* whether they act at this tick */
} abrace_target;

/* Begin DISARMED. Returns 0; not 0 if a setting makes no sense: then nothing else may be called. */
int abrace_target_init(abrace_target *target, const abrace_target_settings *settings);

/* Take a packet of the network: check it, then as abrace_target_command. */
int abrace_target_receive(abrace_target *target, const uint8_t *packet, size_t length);

/* Take a command: outputs are the forces of each group [N], then the table's acceleration [m/s^2]. Of several within a
 * tick the one with the latest counter acts. Returns what has become of it. */
int abrace_target_command(abrace_target *target, uint32_t counter, uint32_t arm, uint32_t wanted,
                          const double outputs[]);

/* Let a law on the target itself make the forces of the next tick, one value for each group [N]: no further from those
 * that abrace commands than `margin` times the capacity, so that abrace's ramps and stops hold. After the packets, at
 * every tick. Returns 0, or ABRACE_REFUSED where no commands are followed. */
int abrace_target_force(abrace_target *target, const double force[], double margin);

/* Stop for a cause of the target's own; until the next tick nothing arms it. To be called at every tick as long as the
 * cause is there. */
void abrace_target_stop(abrace_target *target, uint32_t cause);

/* The next tick: watchdog, ramp and limits make the outputs. `ticks` is 1, or how many periods have gone by since the
 * last call if the hardware missed some: outputs were held in them, and change by no more than in one. */
void abrace_target_tick(abrace_target *target, uint32_t ticks);

/* Write the sample of this tick to a packet of ABRACE_LONGEST_PACKET bytes. The time is that of the tick, by any clock
 * [ns]; `table` is the table's measured displacement [m], not used where it is not measured. Returns the length. */
size_t abrace_target_sample(abrace_target *target, uint64_t time, double table, const double measured[],
                            uint8_t *packet);

#endif
