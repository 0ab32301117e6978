/* The client of cdcrd, the real-time controller of cable-driven continuum robots, for C and C++.
 *
 * How to build and link: docs/c.md. What a driver must do: docs/drivers.md. What a message means: docs/wire-protocol.md.
 *
 * RULES FOR ALL FUNCTIONS
 *
 * Return codes. Every function that returns int returns a CdcrResult: CDCR_OK is 0, CDCR_NOTHING is 1, an error is negative
 *   and cdcr_last_error() says what was wrong, where, and what to do. Any function may return CDCR_ERROR_HANDLE where it takes a
 *   handle, CDCR_ERROR_ARGUMENT, CDCR_ERROR_LINK and CDCR_ERROR_PANIC; its comment names what else it returns.
 * Threads. A handle belongs to the thread that opened it: in another one it is CDCR_ERROR_HANDLE. Open one in each thread that
 *   needs one. Handles that are open when their thread ends are closed. No function may be called from a signal handler. After
 *   fork() the parent's handles stay the parent's: the child opens its own.
 * Ownership. A handle is opened by cdcr_connect or cdcr_driver_connect and closed by cdcr_close or cdcr_driver_close. It is a
 *   number in the form of a pointer: one that was closed is CDCR_ERROR_HANDLE, never a fault. Everything else belongs to the
 *   caller: the library keeps no pointer after a call.
 * Pointers. What a pointer leads to is memory for its type, as many elements as the count beside it. NULL is refused
 *   (CDCR_ERROR_ARGUMENT) where the comment does not allow it. Where a function fails, what it writes to is left as it was,
 *   unless its comment says otherwise. Texts end with a zero and are UTF-8.
 * Time. Nanoseconds of CLOCK_MONOTONIC: cdcr_monotonic_ns(). A timeout of 0 does not wait.
 * Units. SI; the unit ends the name. Lists of bends have two for each section, lists of cables three, from the base on.
 * Codes. Arguments and fields of uint32_t that hold a code are those of the enum that their comment names; others are refused.
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

/* What a function returns. */
typedef enum CdcrResult {
    CDCR_OK = 0,
    CDCR_NOTHING = 1,             /* Nothing came within the timeout, or there is nothing yet. Not an error. */
    CDCR_ERROR_ARGUMENT = -1,     /* NULL, not aligned, not UTF-8, an illegal name, an unknown code, a count out of range. */
    CDCR_ERROR_HANDLE = -2,       /* Not an open handle of this thread. */
    CDCR_ERROR_LAYOUT = -3,       /* Program and library, or library and daemon, are of different versions. */
    CDCR_ERROR_NO_DAEMON = -4,    /* No daemon runs there. */
    CDCR_ERROR_SILENT = -5,       /* The daemon does not answer: it ended, is stopped or is held up. */
    CDCR_ERROR_ACCESS = -6,       /* The daemon belongs to another user. */
    CDCR_ERROR_FULL = -7,         /* Other clients have all places of a service. */
    CDCR_ERROR_LINK = -8,         /* Shared memory is full or cannot be used. */
    CDCR_ERROR_REFUSED = -9,      /* The daemon refused the request: CdcrOutcome says why. */
    CDCR_ERROR_UNCONFIRMED = -10, /* The stop was sent as a signal, which knows no answer: watch the robot. */
    CDCR_ERROR_PANIC = -11        /* The library has a fault. Close the handle, and report the text. */
} CdcrResult;

/* A client that watches, asks and feeds. */
typedef struct CdcrConnection CdcrConnection;
/* The ports of a driver: it measures a robot and moves it. */
typedef struct CdcrDriver CdcrDriver;

/* Where a daemon is. A member that is NULL is what the environment says, or its default; so is each where a CdcrPlace * is
 * NULL. */
typedef struct CdcrPlace {
    const char *robot;  /* CDCR_ROBOT, "cdcr". */
    const char *prefix; /* CDCR_PREFIX, "cdcr_": of the names of files. */
    const char *root;   /* CDCR_ROOT, "/dev/shm/cdcr-<user id>": an absolute path. */
} CdcrPlace;

/* How fast a robot shall move. */
typedef struct CdcrRates {
    double bend_rate_rad_s[CDCR_COORDINATES_MAX]; /* Bend-vector rates [rad/s]. */
    double cable_speed_m_s[CDCR_CABLES_MAX];      /* Cable speeds [m/s]; positive pays out. */
} CdcrRates;

/* Where a robot shall be. */
typedef struct CdcrPosition {
    double bend_rad[CDCR_COORDINATES_MAX];  /* Bend vector [rad]. */
    double cable_length_m[CDCR_CABLES_MAX]; /* Cable lengths [m]. */
} CdcrPosition;

/* What cdcr_driver_update found. */
typedef struct CdcrDriverUpdate {
    CdcrCommand command;  /* The newest command that was taken; zeros if none was. */
    uint64_t new_daemon;  /* Another daemon than before commands from now on: its sender_id; else 0. */
    uint64_t refusals;    /* Commands that were refused since the driver was opened. */
    uint32_t has_command; /* 1: command was taken in this call. */
    uint32_t was_refused; /* 1: a command was refused in this call, and cdcr_last_error() says why. */
} CdcrDriverUpdate;

/* ---- Any thread, without a handle ---- */

/* Now, on the clock of all messages [ns, CLOCK_MONOTONIC]. */
uint64_t cdcr_monotonic_ns(void);

/* The text of the last error of this thread, "" if there was none; also of a command that cdcr_driver_update refused. It
 * belongs to the library and stays valid until the next error or refusal in this thread, or its end. */
const char *cdcr_last_error(void);

/* Stops the robot, by whatever way there is: a place that is kept for stops, and where that does not answer within 0.2 s, a
 * signal, too. It waits for an answer for 1.2 s at most. CDCR_OK: the daemon confirmed it. CDCR_ERROR_UNCONFIRMED: it was sent
 * as a signal. CDCR_ERROR_NO_DAEMON, _SILENT, _ACCESS, _FULL, _REFUSED: the robot was not stopped, as far as is known. */
int cdcr_stop(const CdcrPlace *place);

/* ---- Clients ---- */

/* Connects to a daemon, which may still be starting: tries again until the timeout. layout is CDCR_LAYOUT. *connection becomes
 * a handle that cdcr_close closes, or NULL with an error. A connection outlives its daemon: it goes on with the next one at the
 * same place, which has another header.sender_id and knows no lease, reference or obstacle of before. CDCR_ERROR_LAYOUT,
 * _NO_DAEMON, _SILENT, _ACCESS, _FULL. */
int cdcr_connect(uint64_t layout, const CdcrPlace *place, uint64_t timeout_ns, CdcrConnection **connection);

/* Closes a connection and gives its lease back, for which it waits 0.3 s at most. What the daemon has not yet taken in of what
 * was sent goes with it. NULL is closed already. */
int cdcr_close(CdcrConnection *connection);

/* The newest snapshot of the daemon, at most a second old; waits for one. CDCR_ERROR_SILENT: none came. */
int cdcr_status(CdcrConnection *connection, uint64_t timeout_ns, CdcrStatus *status);

/* Asks for something and waits for the answer. kind is a CdcrRequestKind: track, hold, stop, reset, home, acquire (or renew)
 * and release the lease, reset the statistics; not settings. response may be NULL. CDCR_ERROR_REFUSED: *response has the
 * outcome and the mode, and zeros else. CDCR_ERROR_SILENT: no answer came; a daemon that starts later does not carry it out.
 * CDCR_ERROR_LINK: also where others have all places. Who feeds acquires the lease first, and renews it at a fifth of
 * response->lease_left_ns; accepted chunks renew it, too. */
int cdcr_request(CdcrConnection *connection, uint32_t kind, uint64_t timeout_ns, CdcrResponse *response);

/* Sends a part of a reference, 1 to CDCR_CHUNK_POINTS_MAX points, ahead of its time. mode is a CdcrChunkMode, interpolation a
 * CdcrInterpolation. *header becomes the message's header, to ask cdcr_outcome with; it may be NULL. CDCR_OK says that the
 * chunk was sent: what the daemon makes of it is an event of the telemetry. CDCR_ERROR_FULL. */
int cdcr_feed(CdcrConnection *connection, uint32_t mode, uint32_t interpolation, const CdcrReferencePoint *points, size_t count,
              CdcrHeader *header);

/* Inserts or replaces obstacles, removes those with the ids of the given ones, or removes all: action is a CdcrObstacleAction.
 * At most CDCR_OBSTACLES_MAX; none, and NULL, with clear. header as for cdcr_feed. CDCR_ERROR_FULL. */
int cdcr_obstacles(CdcrConnection *connection, uint32_t action, const CdcrObstacle *obstacles, size_t count, CdcrHeader *header);

/* Sends where a tip sensor of its own saw the tip in the base frame, three numbers [m], and when. The daemon takes it with
 * link.tip_sensor = "separate". header as for cdcr_feed. CDCR_ERROR_FULL, _SILENT. */
int cdcr_send_tip(CdcrConnection *connection, uint64_t measured_ns, const double *tip_position_m, CdcrHeader *header);

/* Begins to receive the telemetry, one record of each cycle from now on. Nothing happens where it is open already.
 * CDCR_ERROR_FULL: the daemon has as many readers as it allows. */
int cdcr_telemetry_open(CdcrConnection *connection);

/* Writes the records that wait, oldest first and capacity at most, and their number into *count. Waits for the first one;
 * CDCR_NOTHING: none came. With an error *count is 0, and what is in records means nothing. What there is no room for waits for
 * the next call: 256 records, then the oldest are lost. *lost, which may be NULL, becomes the number of those since the
 * telemetry was opened. */
int cdcr_telemetry_read(CdcrConnection *connection, uint64_t timeout_ns, CdcrTelemetry *records, size_t capacity, size_t *count,
                        uint64_t *lost);

/* Waits for what the daemon made of a message that was sent after cdcr_telemetry_open. kind is a CdcrEventKind, header that of
 * the message. Records on the way to it are passed over. event->outcome is a CdcrOutcome. CDCR_ERROR_SILENT: no event came. */
int cdcr_outcome(CdcrConnection *connection, uint32_t kind, const CdcrHeader *header, uint64_t timeout_ns, CdcrInputEvent *event);

/* ---- Drivers: docs/drivers.md says what one must do ---- */

/* Connects as a driver that obeys interface, a CdcrInterface. Else as cdcr_connect; cdcr_driver_close closes the handle. */
int cdcr_driver_connect(uint64_t layout, const CdcrPlace *place, uint32_t interface, uint64_t timeout_ns, CdcrDriver **driver);

/* Closes a driver. Stop the motors yourself. NULL is closed already. */
int cdcr_driver_close(CdcrDriver *driver);

/* The robot, as the daemon had it when the driver was opened: the limits that commands are held to. */
int cdcr_driver_robot(CdcrDriver *driver, CdcrRobotDescription *robot);

/* Sends a measurement: measured_ns, kind (a CdcrMeasurementKind), sections, and the array of that kind. The header and the
 * interface are filled in. */
int cdcr_driver_send(CdcrDriver *driver, const CdcrMeasurement *measurement);

/* Sends measured lengths of all cables [m], count of them, three for each section, and when they were measured [ns]. */
int cdcr_driver_send_cable_lengths(CdcrDriver *driver, uint64_t measured_ns, const double *cable_length_m, size_t count);

/* Takes every command that waits, and says what is new. Never waits. A refused command is no error. */
int cdcr_driver_update(CdcrDriver *driver, CdcrDriverUpdate *update);

/* How fast the robot shall move at a time: rest before the first command, and from valid_until_ns of the newest one on. With an
 * error *rates is rest, too. */
int cdcr_driver_rates_at(CdcrDriver *driver, uint64_t now_ns, CdcrRates *rates);

/* Where the robot shall be at a time: on the way to the newest command's target, never past it. CDCR_NOTHING before the first
 * command. */
int cdcr_driver_position_at(CdcrDriver *driver, uint64_t now_ns, CdcrPosition *position);

/* Rests until the next command, which is then a first one again, held to what was sent last: for motors whose torque was off. Call it after the
 * reset. */
int cdcr_driver_forget(CdcrDriver *driver);

#ifdef __cplusplus
}
#endif

#endif
