/* A complete driver with a simulated robot: replace length_m by your motors and encoders (docs/c.md, docs/drivers.md). */
#define _POSIX_C_SOURCE 200809L /* nanosleep, also with -std=c11 */
#include <signal.h>
#include <stdio.h>
#include <string.h>
#include <time.h>

#include "cdcr.h"

static volatile sig_atomic_t ending;
static void end(int signal) { (void)signal; ending = 1; }

static int failed(const char *what) {
    fprintf(stderr, "%s: %s\n", what, cdcr_last_error());
    return 1;
}

int main(int argc, char **argv) {
    const int obeys_speeds = argc == 2 && strcmp(argv[1], "velocity") == 0;
    if (argc != 2 || (!obeys_speeds && strcmp(argv[1], "position") != 0)) {
        fprintf(stderr, "which interface? velocity or position, as link.interface\n");
        return 1;
    }
    signal(SIGINT, end);
    signal(SIGTERM, end);
    const uint32_t interface = obeys_speeds ? CDCR_INTERFACE_VELOCITY : CDCR_INTERFACE_POSITION;
    CdcrDriver *driver;
    if (cdcr_driver_connect(CDCR_LAYOUT, NULL, interface, UINT64_C(10000000000), &driver)) return failed("connect");
    CdcrRobotDescription robot;
    if (cdcr_driver_robot(driver, &robot)) return failed("robot");
    /* Ideal motors and encoders. A cable of the straight robot is as long as the sections up to its own. */
    const size_t cables = 3 * (size_t)robot.sections;
    double length_m[CDCR_CABLES_MAX] = {0};
    for (size_t i = 0; i < cables; i++) length_m[i] = (i < 3 ? 0 : length_m[i - 3]) + robot.section[i / 3].length_m;
    uint64_t last_ns = cdcr_monotonic_ns();
    while (!ending) {
        CdcrDriverUpdate update;
        if (cdcr_driver_update(driver, &update)) return failed("update");
        /* A refused command is counted and reported (the 1st, 2nd, 4th, 8th …). When commands expire, the robot rests. */
        if (update.was_refused && !(update.refusals & (update.refusals - 1))) fprintf(stderr, "refused: %s (%llu so far)\n", cdcr_last_error(), (unsigned long long)update.refusals);
        if (update.new_daemon) fprintf(stderr, "another daemon commands: %#llx\n", (unsigned long long)update.new_daemon);
        /* The motors get a set point in each iteration, with or without a new command. */
        const uint64_t now_ns = cdcr_monotonic_ns();
        CdcrRates rates;
        CdcrPosition position;
        if (obeys_speeds) {
            if (cdcr_driver_rates_at(driver, now_ns, &rates)) return failed("rates");
            for (size_t i = 0; i < cables; i++) length_m[i] += rates.cable_speed_m_s[i] * (double)(now_ns - last_ns) * 1e-9;
        } else if (cdcr_driver_position_at(driver, now_ns, &position) == CDCR_OK) {
            memcpy(length_m, position.cable_length_m, sizeof length_m);
        }
        last_ns = now_ns;
        /* Measure from the first iteration on: the daemon sends no command before. */
        if (cdcr_driver_send_cable_lengths(driver, cdcr_monotonic_ns(), length_m, cables)) return failed("measure");
        nanosleep(&(struct timespec){.tv_nsec = 1000000}, NULL);
    }
    /* Stop your motors here. */
    return cdcr_driver_close(driver) ? failed("close") : 0;
}
