/* SPDX-License-Identifier: GPL-2.0-or-later */
/* The component without its socket, beside a LinuxCNC that does what the test says. A datagram is caught where it would be sent.
   Lines on standard input: `epoch PATH`, `set ...`, `at ...` (the requests, in counts), `disk 0|1` (whether the epoch can be written
   down), `key PATH` (0: it was read), `mac BYTES` (their code), `scan ...`; an answer to each. */
#include "component.h"

static int disk = 1;

static long caught(const uint8_t *bytes, long length) {
    for (long i = 0; i < length; i++) printf("%02x", bytes[i]);
    return length;
}
#define sendto(socket, bytes, length, flags, to, size) caught(bytes, length)

#include "body.c"

int main(void) {
    static char line[8192], letters[16], file[4096];
    int old[9] = {0}, was = 0, size = 1;
    while (fgets(line, sizeof line, stdin)) {
        if (line[0] == 'e') {
            sscanf(line, "epoch %4095s", file); epoch_file = file;
            printf("%d\n", kept_before());
        } else if (line[0] == 's' && line[1] == 'e') {
            int kept;
            sscanf(line, "set %15s %d %d %d %d %d %d %d %d %d %d", letters, &machine, &step_scans, &hold_scans, &time_out_scans, &kept, &size, &limit[0], &limit[1], &rate[0], &rate[1]);
            axes = letters; joints = 1; kept_epoch = stored_epoch = kept; step[0] = step[1] = size;
            printf("%d\n", axes_fit() && settings_fit());
        } else if (line[0] == 'k') {
            sscanf(line, "key %4095s", file); key_file = file;
            printf("%d\n", read_key());
        } else if (line[0] == 'm') {
            uint8_t bytes[1024]; int length = 0;
            for (unsigned byte; sscanf(line + 4 + 2 * length, "%2x", &byte) == 1;) bytes[length++] = byte;
            printf("%016llx\n", (unsigned long long)mac(bytes, length));
        } else if (line[0] == 'd') {
            sscanf(line, "disk %d", &disk);
            printf("0\n");
        } else if (line[0] == 'a') {
            double at[2];
            sscanf(line, "at %lf %lf", at, at + 1);
            for (int i = 0; i < axis_count; i++) request(i) = eoffset(i) = at[i] * size * 1e-6;
            printf("0\n");
        } else {
            /* on, stopped, cut at a limit, a mode in which offsets move, what the control does (1 clears, 2 does not move, 3 is 0.1 s late), ns, probing, touching, frames */
            int on, stopped, cut, mode, does, length; long period; char *p = line;
            sscanf(p, "scan %d %d %d %d %d %ld %d %d%n", &on, &stopped, &cut, &mode, &does, &period, &motion_type, &probe_input, &length); p += length;
            enabled = homed(0) = on; estop_ok = !stopped; user_ok = 1; limited = cut; coord_mode = 0; teleop_mode = mode;
            for (int m = 0; *p == ' ' && m < SENDERS; m++) {
                int words = 0;
                for (p++;; p++) { senders[m].frame[words++] = strtol(p, &p, 10); if (*p != ',') break; }
                senders[m].word_count = words; senders[m].has_frame = 1;
            }
            if (disk) stored_epoch = kept_epoch;
            senders[0].is_there = 1; senders[0].heard_ns = now_ns();
            take(period);
            printf("%d %d ", holds, counts(0));
            tell(period);
            for (int i = 0; i < axis_count; i++) printf(" %.9f %.9f", request(i), probed_offset(i));
            printf("\n");
            /* LinuxCNC: changes of the counts while it is on are its request; clearing takes it away. */
            for (int i = 0; i < axis_count; i++) {
                int changed = counts(i) - old[i]; old[i] = counts(i);
                if (was || on) request(i) += (on ? changed : 0) * 1e-6;
                if (does == 1) request(i) = eoffset(i) = 0;
                if (does == 3) eoffset(i) += (request(i) - eoffset(i)) * 0.01;
                else if (does != 2 && mode) eoffset(i) = request(i);
            }
            was = on;
        }
        fflush(stdout);
    }
    (void)setup; (void)cleanup;
    return 0;
}
