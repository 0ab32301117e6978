/* Invalid arguments and failures, seen from a C program. tests/tests/suite/system/c.rs runs it. */
#include <pthread.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/wait.h>
#include <unistd.h>

#include "cdcr.h"

#define SECOND_NS UINT64_C(1000000000)
#define TIMEOUT_NS (60 * SECOND_NS)

static void check(int line, const char *what, int is, int wanted) {
    if (is == wanted) return;
    fprintf(stderr, "line %d: %s is %d, not %d: %s\n", line, what, is, wanted, cdcr_last_error());
    exit(1);
}
#define IS(call, wanted) check(__LINE__, #call, call, wanted)
/* The same, with a part of the expected error text. */
#define SAYS(call, wanted, words) (IS(call, wanted), check(__LINE__, "a text with " words, strstr(cdcr_last_error(), words) != NULL, 1))

static CdcrConnection *client(void) {
    CdcrConnection *client = NULL;
    IS(cdcr_connect(CDCR_LAYOUT, NULL, TIMEOUT_NS, &client), CDCR_OK);
    return client;
}

static CdcrDriver *driver_of(uint32_t interface) {
    CdcrDriver *driver = NULL;
    IS(cdcr_driver_connect(CDCR_LAYOUT, NULL, interface, TIMEOUT_NS, &driver), CDCR_OK);
    return driver;
}

static CdcrDriver *driver(void) {
    return driver_of(CDCR_INTERFACE_VELOCITY);
}

static void places(void) {
    CdcrConnection *handle = (CdcrConnection *)8;
    SAYS(cdcr_connect(CDCR_LAYOUT + 1, NULL, 0, &handle), CDCR_ERROR_LAYOUT, "another cdcr.h");
    IS(handle == NULL, 1);
    SAYS(cdcr_connect(CDCR_LAYOUT, NULL, 0, NULL), CDCR_ERROR_ARGUMENT, "connection is NULL");
    const struct { CdcrPlace place; CdcrResult result; const char *words; } bad[] = {
        {{.robot = "nobody"}, CDCR_ERROR_NO_DAEMON, "nobody"},
        {{.robot = "a/b"}, CDCR_ERROR_ARGUMENT, "invalid robot name"},
        {{.robot = ""}, CDCR_ERROR_ARGUMENT, "invalid robot name"},
        {{.robot = "tr\xfcnk"}, CDCR_ERROR_ARGUMENT, "place.robot is not UTF-8"},
        {{.prefix = "\xff"}, CDCR_ERROR_ARGUMENT, "place.prefix is not UTF-8"},
        {{.root = "/\xc3"}, CDCR_ERROR_ARGUMENT, "place.root is not UTF-8"},
        {{.prefix = "a b"}, CDCR_ERROR_ARGUMENT, "invalid prefix"},
        {{.root = "here"}, CDCR_ERROR_ARGUMENT, "invalid root path"},
        {{.root = "/nowhere/at/all"}, CDCR_ERROR_NO_DAEMON, "does not exist"},
    };
    for (size_t i = 0; i < sizeof bad / sizeof *bad; i++) {
        CdcrDriver *other = (CdcrDriver *)8;
        IS(cdcr_connect(CDCR_LAYOUT, &bad[i].place, 0, &handle), bad[i].result);
        IS(strstr(cdcr_last_error(), bad[i].words) != NULL, 1);
        IS(cdcr_driver_connect(CDCR_LAYOUT, &bad[i].place, CDCR_INTERFACE_POSITION, 0, &other), bad[i].result);
        IS(cdcr_stop(&bad[i].place), bad[i].result);
        IS(handle == NULL && other == NULL, 1);
    }
    CdcrDriver *other;
    SAYS(cdcr_driver_connect(CDCR_LAYOUT, NULL, CDCR_INTERFACE_NONE, 0, &other), CDCR_ERROR_ARGUMENT, "VELOCITY");
    SAYS(cdcr_driver_connect(CDCR_LAYOUT, NULL, 9, 0, &other), CDCR_ERROR_ARGUMENT, "unknown code 9");
}

/* Every function with an invalid handle: NULL, closed, and one of the other type. */
static void handles(CdcrConnection *none, CdcrDriver *no_driver) {
    static CdcrTelemetry record;
    CdcrStatus status;
    CdcrReferencePoint point = {0};
    CdcrObstacle obstacle = {0};
    CdcrHeader header = {0};
    CdcrInputEvent event;
    const double numbers[CDCR_CABLES_MAX] = {0};
    size_t count = 7;
    SAYS(cdcr_status(none, 0, &status), CDCR_ERROR_HANDLE, "not an open connection");
    IS(cdcr_request(none, CDCR_REQUEST_KIND_HOLD, 0, NULL), CDCR_ERROR_HANDLE);
    IS(cdcr_reset(none, 1, 0, NULL), CDCR_ERROR_HANDLE);
    IS(cdcr_feed(none, 0, 0, &point, 1, NULL), CDCR_ERROR_HANDLE);
    IS(cdcr_obstacles(none, 0, &obstacle, 1, NULL), CDCR_ERROR_HANDLE);
    IS(cdcr_send_tip(none, 0, numbers, NULL), CDCR_ERROR_HANDLE);
    IS(cdcr_telemetry_open(none), CDCR_ERROR_HANDLE);
    IS(cdcr_telemetry_read(none, 0, &record, 1, &count, NULL), CDCR_ERROR_HANDLE);
    IS(count == 0, 1);
    IS(cdcr_outcome(none, CDCR_EVENT_KIND_REFERENCE, &header, 0, &event), CDCR_ERROR_HANDLE);
    CdcrRobotDescription robot;
    CdcrMeasurement measurement = {0};
    CdcrDriverUpdate update;
    CdcrPosition position;
    CdcrRates rates = {{1.0}, {1.0}};
    SAYS(cdcr_driver_robot(no_driver, &robot), CDCR_ERROR_HANDLE, "not an open driver");
    IS(cdcr_driver_send(no_driver, &measurement), CDCR_ERROR_HANDLE);
    IS(cdcr_driver_send_cable_lengths(no_driver, 0, numbers, 9), CDCR_ERROR_HANDLE);
    IS(cdcr_driver_update(no_driver, &update), CDCR_ERROR_HANDLE);
    IS(cdcr_driver_position_at(no_driver, 0, &position), CDCR_ERROR_HANDLE);
    memset(&position, 0, sizeof position);
    IS(cdcr_driver_stand_at(no_driver, &position), CDCR_ERROR_HANDLE);
    IS(cdcr_driver_forget(no_driver), CDCR_ERROR_HANDLE);
    IS(cdcr_driver_rates_at(no_driver, 0, &rates), CDCR_ERROR_HANDLE);
    IS(rates.bend_rate_rad_s[0] == 0.0 && rates.cable_speed_m_s[0] == 0.0, 1);
}

static void arguments(CdcrConnection *open, CdcrDriver *moves) {
    static CdcrTelemetry records[3];
    static CdcrReferencePoint points[CDCR_CHUNK_POINTS_MAX + 1];
    static CdcrObstacle obstacles[CDCR_OBSTACLES_MAX + 1];
    size_t count = 0;
    uint64_t lost = 0;
    CdcrHeader header;
    CdcrInputEvent event;
    CdcrResponse response;
    memset(&response, 0xff, sizeof response);
    CdcrStatus status;
    IS(cdcr_status(open, UINT64_MAX, &status), CDCR_OK);
    SAYS(cdcr_status(open, 0, NULL), CDCR_ERROR_ARGUMENT, "status is NULL");
    SAYS(cdcr_status(open, 0, (CdcrStatus *)(void *)((char *)records + 1)), CDCR_ERROR_ARGUMENT, "not aligned");
    SAYS(cdcr_request(open, 77, 0, &response), CDCR_ERROR_ARGUMENT, "unknown code 77");
    SAYS(cdcr_request(open, CDCR_REQUEST_KIND_SETTINGS, 0, &response), CDCR_ERROR_ARGUMENT, "settings set");
    IS(response.outcome == UINT32_MAX, 1);
    SAYS(cdcr_request(open, CDCR_REQUEST_KIND_TRACK, TIMEOUT_NS, &response), CDCR_ERROR_REFUSED, "no client feeds");
    IS((int)response.outcome, CDCR_OUTCOME_NO_LEASE);
    IS((int)response.mode, CDCR_MODE_HOLDING);
    SAYS(cdcr_feed(open, 0, 0, points, 0, NULL), CDCR_ERROR_ARGUMENT, "not 0");
    SAYS(cdcr_feed(open, 0, 0, points, CDCR_CHUNK_POINTS_MAX + 1, NULL), CDCR_ERROR_ARGUMENT, "128 are the most");
    SAYS(cdcr_feed(open, 0, 0, points, SIZE_MAX, NULL), CDCR_ERROR_ARGUMENT, "128 are the most");
    SAYS(cdcr_feed(open, 0, 0, NULL, 1, NULL), CDCR_ERROR_ARGUMENT, "points is NULL");
    SAYS(cdcr_feed(open, 2, 0, points, 1, NULL), CDCR_ERROR_ARGUMENT, "mode: unknown code 2");
    SAYS(cdcr_feed(open, 0, 2, points, 1, NULL), CDCR_ERROR_ARGUMENT, "interpolation: unknown code 2");
    SAYS(cdcr_obstacles(open, 0, obstacles, CDCR_OBSTACLES_MAX + 1, NULL), CDCR_ERROR_ARGUMENT, "64 are the most");
    SAYS(cdcr_obstacles(open, 3, obstacles, 1, NULL), CDCR_ERROR_ARGUMENT, "action: unknown code 3");
    SAYS(cdcr_send_tip(open, 0, NULL, NULL), CDCR_ERROR_ARGUMENT, "tip_position_m is NULL");
    SAYS(cdcr_telemetry_read(open, 0, records, 1, &count, NULL), CDCR_ERROR_ARGUMENT, "cdcr_telemetry_open first");
    IS(cdcr_telemetry_open(open), CDCR_OK);
    IS(cdcr_telemetry_open(open), CDCR_OK);
    SAYS(cdcr_telemetry_read(open, 0, records, 0, &count, NULL), CDCR_ERROR_ARGUMENT, "at least 1");
    SAYS(cdcr_telemetry_read(open, 0, NULL, 1, &count, NULL), CDCR_ERROR_ARGUMENT, "records is NULL");
    SAYS(cdcr_telemetry_read(open, 0, records, 1, NULL, NULL), CDCR_ERROR_ARGUMENT, "count is NULL");
    /* A buffer that is too small is filled; the next call returns the rest. */
    memset(records, 0x5a, sizeof records);
    usleep(100000);
    IS(cdcr_telemetry_read(open, TIMEOUT_NS, records, 2, &count, &lost), CDCR_OK);
    for (const unsigned char *byte = (unsigned char *)&records[2]; byte < (unsigned char *)&records[3]; byte++) IS(*byte, 0x5a);
    IS(count >= 1 && count <= 2, 1);
    const uint64_t last = records[count - 1].header.sequence;
    IS(cdcr_telemetry_read(open, TIMEOUT_NS, records, 1, &count, &lost), CDCR_OK);
    IS(count == 1 && (records[0].header.sequence == last + 1 || lost > 0), 1);
    /* Outcome of a message: without the lease the daemon refuses a reference; obstacles need no lease. */
    points[0].time_ns = cdcr_monotonic_ns() + TIMEOUT_NS;
    IS(cdcr_feed(open, CDCR_CHUNK_MODE_REPLACE, CDCR_INTERPOLATION_LINEAR, points, 1, &header), CDCR_OK);
    IS(cdcr_outcome(open, CDCR_EVENT_KIND_REFERENCE, &header, TIMEOUT_NS, &event), CDCR_OK);
    IS((int)event.outcome, CDCR_OUTCOME_NO_LEASE);
    obstacles[0].id = 5;
    obstacles[0].start_m[0] = 1.0;
    obstacles[0].radius_m = 0.01;
    obstacles[0].measured_ns = cdcr_monotonic_ns();
    const uint32_t actions[] = {CDCR_OBSTACLE_ACTION_UPSERT, CDCR_OBSTACLE_ACTION_REMOVE, CDCR_OBSTACLE_ACTION_CLEAR};
    for (size_t i = 0; i < 3; i++) {
        const int clears = actions[i] == CDCR_OBSTACLE_ACTION_CLEAR;
        IS(cdcr_obstacles(open, actions[i], clears ? NULL : obstacles, clears ? 0 : 1, &header), CDCR_OK);
        IS(cdcr_outcome(open, CDCR_EVENT_KIND_OBSTACLES, &header, TIMEOUT_NS, &event), CDCR_OK);
        IS((int)event.outcome, CDCR_OUTCOME_ACCEPTED);
    }
    obstacles[0].start_m[0] = 50.0;
    SAYS(cdcr_obstacles(open, CDCR_OBSTACLE_ACTION_UPSERT, obstacles, 1, &header), CDCR_ERROR_ARGUMENT, "are these millimetres?");
    header.sequence += 1000;
    SAYS(cdcr_outcome(open, CDCR_EVENT_KIND_OBSTACLES, &header, SECOND_NS / 10, &event), CDCR_ERROR_SILENT, "telemetry");

    const double lengths_m[CDCR_CABLES_MAX] = {0};
    CdcrPosition position;
    SAYS(cdcr_driver_send(moves, NULL), CDCR_ERROR_ARGUMENT, "measurement is NULL");
    SAYS(cdcr_driver_send_cable_lengths(moves, 0, lengths_m, 8), CDCR_ERROR_ARGUMENT, "has 8 lengths, and the robot has 9");
    SAYS(cdcr_driver_send_cable_lengths(moves, 0, lengths_m, 19), CDCR_ERROR_ARGUMENT, "18 are the most");
    SAYS(cdcr_driver_rates_at(moves, 0, NULL), CDCR_ERROR_ARGUMENT, "rates is NULL");
    IS(cdcr_driver_position_at(moves, 0, &position), CDCR_NOTHING);
}

static void inputs(void) {
    IS(cdcr_last_error()[0], 0);
    places();
    handles(NULL, NULL);
    IS(cdcr_close(NULL), CDCR_OK);
    IS(cdcr_driver_close(NULL), CDCR_OK);
    CdcrConnection *open = client();
    CdcrDriver *moves = driver();
    handles((CdcrConnection *)(void *)moves, (CdcrDriver *)(void *)open);
    arguments(open, moves);
    IS(cdcr_close(open), CDCR_OK);
    IS(cdcr_driver_close(moves), CDCR_OK);
    handles(open, moves);
    IS(cdcr_close(open), CDCR_ERROR_HANDLE);
    IS(cdcr_driver_close(moves), CDCR_ERROR_HANDLE);
}

static CdcrConnection *of_main;

static void *in_a_thread(void *unused) {
    IS(cdcr_last_error()[0], 0);
    CdcrStatus status;
    SAYS(cdcr_status(of_main, 0, &status), CDCR_ERROR_HANDLE, "another thread");
    IS(cdcr_close(of_main), CDCR_ERROR_HANDLE);
    IS(cdcr_stop(NULL), CDCR_OK);
    CdcrConnection *own = client();
    CdcrResponse response;
    SAYS(cdcr_request(own, CDCR_REQUEST_KIND_TRACK, TIMEOUT_NS, &response), CDCR_ERROR_REFUSED, "cdcrctl reset");
    IS((int)response.mode, CDCR_MODE_STOPPED);
    IS(cdcr_reset(own, 0, TIMEOUT_NS, &response), CDCR_OK);
    IS((int)response.pose_section, 0);
    IS(cdcr_reset(own, 1, TIMEOUT_NS, NULL), CDCR_OK);
    /* The end of the thread closes the connection and gives the lease back. */
    IS(cdcr_request(own, CDCR_REQUEST_KIND_ACQUIRE_LEASE, TIMEOUT_NS, NULL), CDCR_OK);
    return unused;
}

static void threads(void) {
    of_main = client();
    for (int i = 0; i < 20; i++) {
        pthread_t thread;
        IS(pthread_create(&thread, NULL, in_a_thread, NULL), 0);
        IS(pthread_join(thread, NULL), 0);
        CdcrResponse response;
        IS(cdcr_request(of_main, CDCR_REQUEST_KIND_ACQUIRE_LEASE, TIMEOUT_NS, &response), CDCR_OK);
        IS(cdcr_request(of_main, CDCR_REQUEST_KIND_RELEASE_LEASE, TIMEOUT_NS, &response), CDCR_OK);
    }
}

static void forks(void) {
    CdcrConnection *parents = client();
    CdcrStatus status;
    const pid_t child = fork();
    if (child == 0) {
        SAYS(cdcr_status(parents, 0, &status), CDCR_ERROR_HANDLE, "parent process");
        CdcrConnection *own = client();
        IS(cdcr_status(own, TIMEOUT_NS, &status), CDCR_OK);
        exit(0);
    }
    int end = -1;
    IS(waitpid(child, &end, 0) == child, 1);
    IS(end, 0);
    IS(cdcr_status(parents, TIMEOUT_NS, &status), CDCR_OK);
    IS(cdcr_request(parents, CDCR_REQUEST_KIND_HOLD, TIMEOUT_NS, NULL), CDCR_OK);
}

/* Prints the progress on standard output, and waits for a line while the test acts. */
static void reached(const char *what) {
    char line[16];
    printf("%s\n", what);
    fflush(stdout);
    IS(fgets(line, sizeof line, stdin) != NULL, 1);
}

static void lease(void) {
    CdcrConnection *second = client();
    CdcrResponse response;
    SAYS(cdcr_request(second, CDCR_REQUEST_KIND_ACQUIRE_LEASE, TIMEOUT_NS, &response), CDCR_ERROR_REFUSED, "another client");
    IS((int)response.outcome, CDCR_OUTCOME_LEASE_HELD);
    reached("refused");
    IS(cdcr_request(second, CDCR_REQUEST_KIND_ACQUIRE_LEASE, TIMEOUT_NS, &response), CDCR_OK);
    IS(response.lease_left_ns > SECOND_NS, 1);
    /* The end of the program closes the connection. */
}

static void away(void) {
    CdcrConnection *open = client();
    CdcrDriver *moves = driver();
    CdcrStatus status;
    CdcrDriverUpdate update;
    CdcrRates rates = {{1.0}, {1.0}};
    CdcrRobotDescription robot;
    IS(cdcr_driver_robot(moves, &robot), CDCR_OK);
    IS(cdcr_status(open, TIMEOUT_NS, &status), CDCR_OK);
    const uint64_t before = status.header.sender_id;
    reached("connected");
    /* A status is valid for a second. */
    const uint64_t last_ns = cdcr_monotonic_ns() + TIMEOUT_NS;
    while (cdcr_status(open, SECOND_NS / 10, &status) == CDCR_OK) IS(cdcr_monotonic_ns() < last_ns, 1);
    SAYS(cdcr_status(open, SECOND_NS / 10, &status), CDCR_ERROR_SILENT, "has ended");
    SAYS(cdcr_request(open, CDCR_REQUEST_KIND_HOLD, SECOND_NS / 10, NULL), CDCR_ERROR_SILENT, "has ended");
    IS(cdcr_driver_update(moves, &update), CDCR_OK);
    IS(cdcr_driver_rates_at(moves, cdcr_monotonic_ns(), &rates), CDCR_OK);
    for (size_t i = 0; i < CDCR_CABLES_MAX; i++) IS(rates.cable_speed_m_s[i] == 0.0, 1);
    CdcrMeasurement measurement = {.kind = CDCR_MEASUREMENT_KIND_CONFIGURATION, .sections = robot.sections};
    measurement.measured_ns = cdcr_monotonic_ns();
    IS(cdcr_driver_send(moves, &measurement), CDCR_OK);
    CdcrConnection *second;
    SAYS(cdcr_connect(CDCR_LAYOUT, NULL, 0, &second), CDCR_ERROR_NO_DAEMON, "cdcrd run");
    IS(cdcr_stop(NULL), CDCR_ERROR_NO_DAEMON);
    reached("alone");
    IS(cdcr_status(open, TIMEOUT_NS, &status), CDCR_OK);
    IS(status.header.sender_id != before, 1);
    IS(cdcr_close(open), CDCR_OK);
    IS(cdcr_driver_close(moves), CDCR_OK);
}

/* Measures the bend of the first section until a position is commanded; a fault is reset. */
static CdcrPosition position_of(CdcrConnection *open, CdcrDriver *moves, double bend_rad) {
    CdcrMeasurement measurement = {.kind = CDCR_MEASUREMENT_KIND_CONFIGURATION, .sections = 3};
    measurement.bend_rad[0] = bend_rad;
    CdcrPosition position;
    CdcrDriverUpdate update;
    CdcrStatus status;
    const uint64_t last_ns = cdcr_monotonic_ns() + TIMEOUT_NS;
    for (;;) {
        IS(cdcr_monotonic_ns() < last_ns, 1);
        measurement.measured_ns = cdcr_monotonic_ns();
        IS(cdcr_driver_send(moves, &measurement), CDCR_OK);
        usleep(5000);
        IS(cdcr_driver_update(moves, &update), CDCR_OK);
        if (cdcr_driver_position_at(moves, cdcr_monotonic_ns(), &position) == CDCR_OK) return position;
        IS(cdcr_status(open, TIMEOUT_NS, &status), CDCR_OK);
        if (status.mode == CDCR_MODE_FAULTED) cdcr_reset(open, 1, TIMEOUT_NS, NULL);
    }
}

/* The robot droops: it is measured beside its motors. A driver that is started again leaves them where they stand. */
static void stands(void) {
    CdcrConnection *open = client();
    CdcrDriver *moves = driver_of(CDCR_INTERFACE_POSITION);
    const CdcrPosition place = position_of(open, moves, 0.3);
    IS(place.bend_rad[0] == 0.3, 1);
    IS(cdcr_driver_close(moves), CDCR_OK);
    moves = driver_of(CDCR_INTERFACE_POSITION);
    CdcrPosition wrong[2] = {place, place};
    SAYS(cdcr_driver_stand_at(moves, NULL), CDCR_ERROR_ARGUMENT, "place is NULL");
    SAYS(cdcr_driver_stand_at(moves, (CdcrPosition *)(void *)((char *)wrong + 1)), CDCR_ERROR_ARGUMENT, "place is not aligned");
    wrong[0].bend_rad[0] = 0.0 / 0.0;
    SAYS(cdcr_driver_stand_at(moves, &wrong[0]), CDCR_ERROR_ARGUMENT, "not finite");
    /* The bends alone, and millimetres. */
    memset(wrong[0].cable_length_m, 0, sizeof wrong[0].cable_length_m);
    wrong[0].bend_rad[0] = 0.3;
    IS(cdcr_driver_stand_at(moves, &wrong[0]), CDCR_ERROR_ARGUMENT);
    for (size_t i = 0; i < CDCR_CABLES_MAX; i++) wrong[1].cable_length_m[i] *= 1e3;
    IS(cdcr_driver_stand_at(moves, &wrong[1]), CDCR_ERROR_ARGUMENT);
    IS(cdcr_driver_stand_at(moves, &place), CDCR_OK);
    const CdcrPosition first = position_of(open, moves, 0.2);
    for (size_t i = 0; i < 9; i++) {
        const double way_m = first.cable_length_m[i] - place.cable_length_m[i];
        IS(way_m > -1e-12 && way_m < 1e-12, 1);
    }
    SAYS(cdcr_driver_stand_at(moves, &place), CDCR_ERROR_ARGUMENT, "obeys a command already");
    /* Without a stated place they go to where the robot is measured. */
    IS(cdcr_driver_close(moves), CDCR_OK);
    moves = driver_of(CDCR_INTERFACE_POSITION);
    IS(position_of(open, moves, 0.2).bend_rad[0] == 0.2, 1);
    IS(cdcr_driver_close(moves), CDCR_OK);
    IS(cdcr_close(open), CDCR_OK);
}

int main(int argc, char **argv) {
    const struct { const char *name; void (*run)(void); } cases[] = {
        {"inputs", inputs}, {"threads", threads}, {"forks", forks}, {"lease", lease}, {"away", away}, {"stands", stands}};
    for (size_t i = 0; argc == 2 && i < sizeof cases / sizeof *cases; i++) {
        if (strcmp(argv[1], cases[i].name) == 0) {
            cases[i].run();
            return 0;
        }
    }
    fprintf(stderr, "which case? inputs, threads, forks, lease, away or stands\n");
    return 2;
}
