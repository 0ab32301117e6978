/* Client library of cdcrd, the real-time controller of cable-driven continuum robots, for C and C++.
 *
 * Building and linking: docs/c.md. Obligations of a driver: docs/drivers.md. Meaning of the messages: docs/wire-protocol.md.
 *
 * RULES FOR ALL FUNCTIONS
 *
 * Return codes. Every function that returns int returns a CdcrResult: CDCR_OK is 0, CDCR_NOTHING is 1, errors are negative. After
 *   an error, cdcr_last_error() names the problem, its location and the remedy. Any function may return CDCR_ERROR_HANDLE if it
 *   takes a handle, CDCR_ERROR_ARGUMENT, CDCR_ERROR_LINK and CDCR_ERROR_PANIC; its comment lists the others.
 * Threads. A handle belongs to the thread that opened it: in another one it gives CDCR_ERROR_HANDLE. Open one in each thread that
 *   needs one. The end of a thread closes its handles. No function may be called from a signal handler. After fork() the
 *   parent's handles belong to the parent only: the child opens its own.
 * Ownership. A handle is opened by cdcr_connect or cdcr_driver_connect and closed by cdcr_close or cdcr_driver_close. It is a
 *   number in the form of a pointer: a closed one gives CDCR_ERROR_HANDLE and no crash. Everything else belongs to the caller:
 *   the library keeps no pointer after a call.
 * Pointers. A pointer refers to memory of its type, with as many elements as the count beside it. NULL is refused
 *   (CDCR_ERROR_ARGUMENT) unless the comment allows it. If a function fails, its output arguments are unchanged, unless its
 *   comment states otherwise. Strings are UTF-8 and end with a zero.
 * Time. Nanoseconds of CLOCK_MONOTONIC: cdcr_monotonic_ns(). A timeout of 0 does not wait.
 * Units. SI; names end with the unit. Lists of bends have two entries per section, lists of cables three, base first.
 * Codes. Arguments and fields of type uint32_t with a code take the values of the enum named in their comment; others are refused.
 *
 * The library installs no signal handler, starts no thread and writes no log; a panic inside prints one line on standard error. */
#ifndef CDCR_H
#define CDCR_H

#include <stddef.h>
#include <stdint.h>

#include "cdcr_messages.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Return codes. */
typedef enum CdcrResult {
    CDCR_OK = 0,
    CDCR_NOTHING = 1,             /* Nothing arrived within the timeout, or there is nothing yet. Not an error. */
    CDCR_ERROR_ARGUMENT = -1,     /* NULL, not aligned, not UTF-8, an invalid name, an unknown code, a count out of range. */
    CDCR_ERROR_HANDLE = -2,       /* Not an open handle of this thread. */
    CDCR_ERROR_LAYOUT = -3,       /* Program and library, or library and daemon, have different versions. */
    CDCR_ERROR_NO_DAEMON = -4,    /* No daemon is running there. */
    CDCR_ERROR_SILENT = -5,       /* The daemon does not answer: it has ended, is stopped or is blocked. */
    CDCR_ERROR_ACCESS = -6,       /* The daemon belongs to another user. */
    CDCR_ERROR_FULL = -7,         /* The service has as many clients as it allows. */
    CDCR_ERROR_LINK = -8,         /* Shared memory is full or cannot be used. */
    CDCR_ERROR_REFUSED = -9,      /* The daemon refused the request: CdcrOutcome says why. */
    CDCR_ERROR_UNCONFIRMED = -10, /* The stop was sent as a signal, which has no answer: watch the robot. */
    CDCR_ERROR_PANIC = -11        /* The library has a fault. Close the handle, and report the text. */
} CdcrResult;

/* A client that monitors, sends requests and feeds references. */
typedef struct CdcrConnection CdcrConnection;
/* The ports of a driver, which measures and moves a robot. */
typedef struct CdcrDriver CdcrDriver;

/* Place of a daemon. A NULL member is replaced by the environment variable, or by its default. A NULL CdcrPlace * replaces
 * all members. */
typedef struct CdcrPlace {
    const char *robot;  /* CDCR_ROBOT, "cdcr". */
    const char *prefix; /* CDCR_PREFIX, "cdcr_": prefix of the files. */
    const char *root;   /* CDCR_ROOT, "/dev/shm/cdcr-<user id>": an absolute path. */
} CdcrPlace;

/* Commanded rates. */
typedef struct CdcrRates {
    double bend_rate_rad_s[CDCR_COORDINATES_MAX]; /* Bend-vector rates [rad/s]. */
    double cable_speed_m_s[CDCR_CABLES_MAX];      /* Cable speeds [m/s]; positive pays out. */
} CdcrRates;

/* Commanded position. */
typedef struct CdcrPosition {
    double bend_rad[CDCR_COORDINATES_MAX];  /* Bend vector [rad]. */
    double cable_length_m[CDCR_CABLES_MAX]; /* Cable lengths [m]. */
} CdcrPosition;

/* Result of cdcr_driver_update. */
typedef struct CdcrDriverUpdate {
    CdcrCommand command;  /* The newest accepted command; zeros without one. */
    uint64_t new_daemon;  /* sender_id of a new daemon that has taken over; otherwise 0. Positions stay where they stand, and move on from there. */
    uint64_t refusals;    /* Commands refused since the driver was opened. */
    uint32_t has_command; /* 1: command was accepted in this call. */
    uint32_t was_refused; /* 1: a command was refused in this call; cdcr_last_error() has the reason. */
} CdcrDriverUpdate;

/* ---- Any thread, without a handle ---- */

/* Present time on the clock of all messages [ns, CLOCK_MONOTONIC]. */
uint64_t cdcr_monotonic_ns(void);

/* The text of the last error of this thread, "" without one; also of a command refused by cdcr_driver_update. It belongs to
 * the library and is valid until the next error or refusal in this thread, or the end of the thread. */
const char *cdcr_last_error(void);

/* Stops the robot by every available means: first with a request over a port reserved for stops. If no answer arrives
 * within 0.2 s, it also sends a signal, and waits for an answer for another 1 s. Without a daemon it waits up to 1 s for
 * one that restarts. CDCR_OK: the daemon confirmed the stop. CDCR_ERROR_UNCONFIRMED: the stop was sent as a signal.
 * CDCR_ERROR_NO_DAEMON, _SILENT, _ACCESS, _FULL, _REFUSED: as far as is known, the robot was not stopped. */
int cdcr_stop(const CdcrPlace *place);

/* ---- Clients ---- */

/* Connects to a daemon that may still be starting: retries until the timeout. layout is CDCR_LAYOUT. *connection becomes a
 * handle for cdcr_close, or NULL in case of an error. A connection outlives its daemon: it continues with the next one at
 * the same place. That daemon has another header.sender_id, and no lease, reference or obstacle of the previous one.
 * CDCR_ERROR_LAYOUT, _NO_DAEMON, _SILENT, _ACCESS, _FULL. */
int cdcr_connect(uint64_t layout, const CdcrPlace *place, uint64_t timeout_ns, CdcrConnection **connection);

/* Closes a connection and gives its lease back, for which it waits at most 0.3 s. Sent messages that the daemon has not
 * received yet are lost. NULL is ignored. */
int cdcr_close(CdcrConnection *connection);

/* The newest status of the daemon, at most a second old; waits for one. CDCR_ERROR_SILENT: none arrived. */
int cdcr_status(CdcrConnection *connection, uint64_t timeout_ns, CdcrStatus *status);

/* Sends a request and waits for the answer. kind is a CdcrRequestKind: track, hold, stop, reset, home, acquire (or renew)
 * and release the lease, reset the statistics; not settings. response may be NULL. CDCR_ERROR_REFUSED: *response has the
 * outcome and the mode; after any other error it is zeros. CDCR_ERROR_SILENT: no answer arrived; a daemon that starts later
 * does not execute the request. CDCR_ERROR_LINK: also if there are as many requesting clients as the daemon allows. A
 * client that feeds acquires the lease first, and renews it at a fifth of response->lease_left_ns; accepted chunks renew
 * it, too. */
int cdcr_request(CdcrConnection *connection, uint32_t kind, uint64_t timeout_ns, CdcrResponse *response);

/* Sends a reset, as cdcr_request does. accept_pose, 1: the measured pose is right although it is far from where the last
 * command left the robot, for example after a motion by hand; control begins there. 0: such a reset is refused with
 * CDCR_OUTCOME_POSE_DIFFERS, because encoders may have lost their zero; *response has the section and the difference. */
int cdcr_reset(CdcrConnection *connection, uint32_t accept_pose, uint64_t timeout_ns, CdcrResponse *response);

/* Sends a part of a reference, 1 to CDCR_CHUNK_POINTS_MAX points, ahead of time. mode is a CdcrChunkMode, interpolation
 * a CdcrInterpolation. *header becomes the message's header, the argument of cdcr_outcome; header may be NULL. CDCR_OK: the
 * chunk was sent; its outcome is an event of the telemetry. CDCR_ERROR_FULL. */
int cdcr_feed(CdcrConnection *connection, uint32_t mode, uint32_t interpolation, const CdcrReferencePoint *points, size_t count,
              CdcrHeader *header);

/* Inserts or replaces obstacles, removes those with the ids of the given ones, or removes all: action is a
 * CdcrObstacleAction. At most CDCR_OBSTACLES_MAX; for clear, count 0 and NULL. header as for cdcr_feed. An obstacle to be
 * inserted that is farther away than thirty robot lengths, or is larger than the robot and contains the base, is
 * taken for one in millimetres: CDCR_ERROR_ARGUMENT, and nothing is sent. CDCR_ERROR_FULL, _SILENT. */
int cdcr_obstacles(CdcrConnection *connection, uint32_t action, const CdcrObstacle *obstacles, size_t count, CdcrHeader *header);

/* Sends the tip position measured by a separate tip sensor in the base frame, three numbers [m], and its time. The daemon
 * uses it with link.tip_sensor = "separate". header as for cdcr_feed. CDCR_ERROR_FULL, _SILENT. */
int cdcr_send_tip(CdcrConnection *connection, uint64_t measured_ns, const double *tip_position_m, CdcrHeader *header);

/* Opens the telemetry: one record per cycle from now on. No effect if it is open. CDCR_ERROR_FULL: the daemon has as many
 * readers as it allows. */
int cdcr_telemetry_open(CdcrConnection *connection);

/* Waits for a record, then writes the queued records, oldest first, at most capacity, and their number into *count.
 * CDCR_NOTHING: none arrived. After an error *count is 0 and records is undefined. Further records stay queued for the next
 * call: 256 records, then the oldest are lost. *lost becomes the number of lost records since the telemetry was opened;
 * lost may be NULL. */
int cdcr_telemetry_read(CdcrConnection *connection, uint64_t timeout_ns, CdcrTelemetry *records, size_t capacity, size_t *count,
                        uint64_t *lost);

/* Waits for the outcome of a message that was sent after cdcr_telemetry_open. kind is a CdcrEventKind, header that of the
 * message. Records before the outcome are skipped. event->outcome is a CdcrOutcome. CDCR_ERROR_SILENT: no event arrived. */
int cdcr_outcome(CdcrConnection *connection, uint32_t kind, const CdcrHeader *header, uint64_t timeout_ns, CdcrInputEvent *event);

/* ---- Drivers: docs/drivers.md has their obligations ---- */

/* Connects as a driver that obeys interface, a CdcrInterface. Otherwise as cdcr_connect; cdcr_driver_close closes the
 * handle. */
int cdcr_driver_connect(uint64_t layout, const CdcrPlace *place, uint32_t interface, uint64_t timeout_ns, CdcrDriver **driver);

/* Closes a driver. It does not stop the motors. NULL is ignored. */
int cdcr_driver_close(CdcrDriver *driver);

/* The robot description when the driver was opened, with the limits that apply to commands. */
int cdcr_driver_robot(CdcrDriver *driver, CdcrRobotDescription *robot);

/* Sends a measurement: measured_ns, kind (a CdcrMeasurementKind), sections, and the array of that kind. The library fills
 * in the header and the interface. */
int cdcr_driver_send(CdcrDriver *driver, const CdcrMeasurement *measurement);

/* Sends the lengths of all cables [m], count of them, three per section, and the time of their measurement [ns]. */
int cdcr_driver_send_cable_lengths(CdcrDriver *driver, uint64_t measured_ns, const double *cable_length_m, size_t count);

/* Processes all queued commands and returns what is new. Never blocks. A refused command is not an error. */
int cdcr_driver_update(CdcrDriver *driver, CdcrDriverUpdate *update);

/* Commanded rates at a time: rest before the first command and after valid_until_ns of the newest one. After an error
 * *rates is rest, too. */
int cdcr_driver_rates_at(CdcrDriver *driver, uint64_t now_ns, CdcrRates *rates);

/* Commanded position at a time: on the way to the target of the newest command, without overshoot. It stays where it stands
 * after missed commands in Stopped and Faulted. CDCR_NOTHING before the first command, and until the reset of a robot
 * that is Stopped or Faulted then: the motors hold. */
int cdcr_driver_position_at(CdcrDriver *driver, uint64_t now_ns, CdcrPosition *position);

/* States where the motors of positions stand before the first command, bends and cables: the last cdcr_driver_position_at that this
 * driver gave them before it was started again. They stay there, and keep their distance from the robot, which a load has
 * bent; without it they move to where the robot is measured. Do not call it where the motors were without torque. cdcr_driver_update
 * refuses a first command more than 0.2 rad from it. CDCR_ERROR_ARGUMENT: a number is not finite or beyond the robot's limits,
 * the cables are not those of the bends, or the driver obeys a command already. */
int cdcr_driver_stand_at(CdcrDriver *driver, const CdcrPosition *place);

/* Rests until the next command, which is then treated as the first and must match the last measurement. For motors whose
 * torque was off. Call it after the reset. */
int cdcr_driver_forget(CdcrDriver *driver);

#ifdef __cplusplus
}
#endif

#endif
