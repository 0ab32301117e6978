/* Moves the tip sideways by some millimetres and back, and reports the error (docs/c.md). */
#include <inttypes.h>
#include <math.h>
#include <stdio.h>

#include "cdcr.h"

#define SECOND_NS UINT64_C(1000000000)
#define TIMEOUT_NS (10 * SECOND_NS)
#define POINTS 100
#define STEP_NS (SECOND_NS / 50)

static int failed(const char *what) {
    fprintf(stderr, "%s: %s\n", what, cdcr_last_error());
    return 1;
}

int main(void) {
    CdcrConnection *client;
    if (cdcr_connect(CDCR_LAYOUT, NULL, TIMEOUT_NS, &client)) return failed("connect");
    CdcrStatus status;
    if (cdcr_status(client, TIMEOUT_NS, &status)) return failed("status");
    double length_m = 0;
    for (uint32_t i = 0; i < status.robot.sections; i++) length_m += status.robot.section[i].length_m;
    printf("robot %.*s: %" PRIu32 " sections, %g m\n", CDCR_TEXT_BYTES, status.robot_name, status.robot.sections, length_m);

    /* Opened before the first chunk, because the telemetry contains its outcome. A client that feeds needs the lease. */
    if (cdcr_telemetry_open(client)) return failed("telemetry");
    if (cdcr_request(client, CDCR_REQUEST_KIND_ACQUIRE_LEASE, TIMEOUT_NS, NULL)) return failed("lease");

    /* Two seconds of a reference that begins in a second, in one chunk. Continue longer ones with CDCR_CHUNK_MODE_APPEND. */
    CdcrReferencePoint points[POINTS] = {0};
    const uint64_t begin_ns = cdcr_monotonic_ns() + SECOND_NS;
    for (uint64_t i = 0; i < POINTS; i++) {
        const double part = (double)i / (POINTS - 1);
        points[i].time_ns = begin_ns + i * STEP_NS;
        points[i].position_m[0] = 0.05 * length_m * pow(sin(3.141592653589793 * part), 2);
        points[i].position_m[2] = 0.99 * length_m;
    }
    CdcrHeader sent;
    if (cdcr_feed(client, CDCR_CHUNK_MODE_REPLACE, CDCR_INTERPOLATION_CUBIC, points, POINTS, &sent)) return failed("feed");
    CdcrInputEvent event;
    if (cdcr_outcome(client, CDCR_EVENT_KIND_REFERENCE, &sent, TIMEOUT_NS, &event)) return failed("outcome");
    if (event.outcome != CDCR_OUTCOME_ACCEPTED) return fprintf(stderr, "refused: outcome %" PRIu32 "\n", event.outcome), 1;
    if (cdcr_request(client, CDCR_REQUEST_KIND_TRACK, TIMEOUT_NS, NULL)) return failed("track");

    static CdcrTelemetry records[16];
    uint64_t tracked = 0, renewed_ns = cdcr_monotonic_ns(), lost = 0;
    double error_m = 0;
    while (cdcr_monotonic_ns() < begin_ns + POINTS * STEP_NS) {
        size_t count;
        if (cdcr_telemetry_read(client, SECOND_NS / 10, records, 16, &count, &lost) < 0) return failed("read");
        for (size_t i = 0; i < count; i++) {
            if (records[i].mode != CDCR_MODE_TRACKING) continue;
            tracked++;
            error_m = records[i].position_error_m;
        }
        if (cdcr_monotonic_ns() > renewed_ns + SECOND_NS / 10) {
            if (cdcr_request(client, CDCR_REQUEST_KIND_ACQUIRE_LEASE, TIMEOUT_NS, NULL)) return failed("renew");
            renewed_ns = cdcr_monotonic_ns();
        }
    }
    printf("%" PRIu64 " cycles tracked, %" PRIu64 " records lost, error at the end %.3g mm\n", tracked, lost, 1e3 * error_m);
    /* Closing gives the lease back: the robot holds. */
    return cdcr_close(client) ? failed("close") : 0;
}
