/* SPDX-License-Identifier: GPL-2.0-or-later */
/* The component with its socket, scan by scan. */
#include "component.h"
#include "body.c"

static int number(void) {
    int value;
    if (scanf("%d", &value) != 1) exit(3);
    return value;
}

/* Reads the settings, prints the port; then, for each line, one scan: 1 where the axes shall hold. Prints whether they did. */
int main(int count, char **arguments) {
    static char letters[16];
    struct sockaddr_in own;
    socklen_t size = sizeof own;
    int at_start[MOST_AXES] = {0}, shall_hold, tick, many;
    if (count != 3 || scanf("%15s", letters) != 1) return 3;
    axes = letters; epoch_file = arguments[1]; key_file = arguments[2]; port = 0; joints = 1;
    many = strlen(letters);
    machine = number(); step_scans = number(); hold_scans = number(); time_out_scans = number(); tick = number();
    for (int i = 0; i < many; i++) { limit[i] = number(); step[i] = 1; }
    for (int i = 0; i < many; i++) rate[i] = number();
    for (int i = 0; i < many; i++) at_start[i] = number();
    if (setup(NULL, "", 0)) return 4;
    barrier.tick = tick;
    if (getsockname(udp, (struct sockaddr *)&own, &size)) return 5;
    printf("%d\n", ntohs(own.sin_port));
    fflush(stdout);
    enabled = estop_ok = user_ok = teleop_mode = homed(0) = 1;
    while (scanf("%d", &shall_hold) == 1) {
        estop_ok = !shall_hold;
        /* Here scans take no time, and a disk does. */
        while ((uint16_t)(seen(&kept_epoch) - seen(&stored_epoch)) > EPOCHS_AHEAD / 2) usleep(100);
        /* The control goes by the counts of the scan before. */
        for (int i = 0; i < axis_count; i++) request(i) = eoffset(i) = (at_start[i] + counts(i)) * 1e-6;
        take(1000000);
        tell(1000000);
        printf("%d\n", holds);
        fflush(stdout);
    }
    cleanup();
    return 0;
}
