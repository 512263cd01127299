component volcomp "Bridge to a volcomp gateway in the servo thread: external offsets behind a barrier.";
description """
\\fBtake\\fR goes before motion-controller: it takes the frames that came, lets the barrier decide, and writes the counts.
\\fBtell\\fR goes after it: it sends the state of this cycle to those who listen. Settings are given when it is loaded, and
refused then; volcomp-servo.tcl does all of it from the section [VOLCOMP] of the INI file.
""";
pin in float pos_cmd-#[9] "axis.L.pos-cmd, those of the barrier first";
pin in float eoffset-#[9] "axis.L.eoffset";
pin in float request-#[9] "axis.L.eoffset-request";
pin in bit homed-#[16] "joint.N.homed";
pin in bit enabled "motion.motion-enabled";
pin in bit estop_ok "iocontrol.0.emc-enable-in";
pin in bit user_ok "iocontrol.0.user-enable-out";
pin in bit limited "motion.eoffset-limited";
pin in bit coord_mode "motion.coord-mode";
pin in bit teleop_mode "motion.teleop-mode";
pin in s32 motion_type "motion.motion-type";
pin in bit probe_input "motion.probe-input";
pin out s32 counts-#[9] "to axis.L.eoffset-counts";
pin out bit enable = 1 "to axis.L.eoffset-enable";
pin out float absorbed-#[9] "what the control has taken into its position or lost so far, mm or deg";
pin out float probed_offset-#[9] "the offset at the last contact of a probe (G38.4, G38.5: at its loss), mm or deg";
pin out bit holds "nothing moves";
pin out u32 owner "the gateway whose frames are taken";
pin out u32 epoch "moves on at each start and time-out";
pin out u32 refused "why the last frame was not taken";
pin out u32 taken "frames that were taken";
function take fp "before motion-controller";
function tell fp "after motion-controller";
option singleton yes;
option extra_setup yes;
option extra_cleanup yes;
license "GPL";
author "The volcomp developers";
include <sys/socket.h>;
include <netinet/in.h>;
include <arpa/inet.h>;
include <errno.h>;
include <fcntl.h>;
include <pthread.h>;
include <stdio.h>;
include <stdlib.h>;
include <string.h>;
include <time.h>;
include <unistd.h>;
include <math.h>;
;;
/* SPDX-License-Identifier: GPL-2.0-or-later */
static char *axes = "XYZ";            RTAPI_MP_STRING(axes, "axes of the barrier, in the gateway's order");
static char *reads = "";              RTAPI_MP_STRING(reads, "axes of which only the positions are told");
static char *listen_on = "127.0.0.1"; RTAPI_MP_STRING(listen_on, "IPv4 address on which the bridge listens");
static char *epoch_file = "";         RTAPI_MP_STRING(epoch_file, "file that keeps the epoch");
static int port = 47001;              RTAPI_MP_INT(port, "UDP port");
static int machine = 0;               RTAPI_MP_INT(machine, "number of the machine");
static int joints = 3;                RTAPI_MP_INT(joints, "number of joints");
#define MOST 9
static int step[MOST];                RTAPI_MP_ARRAY_INT(step, 9, "size of a count, nm or millionths of a degree");
static int limit[MOST];               RTAPI_MP_ARRAY_INT(limit, 9, "largest correction, counts");
static int rate[MOST];                RTAPI_MP_ARRAY_INT(rate, 9, "largest movement in a step, counts");
static int step_scans = 1;            RTAPI_MP_INT(step_scans, "cycles from step to step");
static int hold_scans = 100;          RTAPI_MP_INT(hold_scans, "largest age of a frame, cycles");
static int time_out_scans = 300;      RTAPI_MP_INT(time_out_scans, "cycles without a frame after which the correction goes to zero");

#define SENDERS 4
#define FRAME_HEAD 4
#define REPORT_HEAD 8
#define LANDS_WITHIN 5
#define SETTLES 20
#define WORD 32767
/* How long nothing moves after an offset was lost. */
#define LOST_NS 1000000000LL
/* How far an offset may be off besides what its value moved in the time of the way, and for how long: some counts, and what the
   planner leaves where it stops (nm or millionths of a degree). */
#define OFF_BY_COUNTS 3
#define OFF_BY 10.0
#define WAY_NS 250000000.0
#define OFF_NS 500000000LL
#define LISTENS_NS 1000000000LL
enum { ESTOP = 1, ENABLED = 2, HOMED = 4, LIMITED = 8, PROBING = 16, LOST = 32 };
enum { R_NONE, R_CHECKSUM, R_EPOCH, R_TICK, R_OWNER, R_SEQUENCE, R_VALUE };

/* The barrier: whole counts, 16-bit words, time in scans. */
static struct {
    uint16_t age, tick, holder, sequence, refusal, waited, silent;
    int found_any[SENDERS]; uint16_t found[SENDERS][2];
    int applied[MOST], from[MOST], goal[MOST];
    unsigned steps, done;
} b;
static int n, n_all, began;
static uint32_t layout;

static struct sender { struct sockaddr_in at; long long heard; int is_there, has_frame, words; uint16_t frame[40]; } senders[SENDERS];
static int fd = -1;
static uint32_t run, sequence, crc_table[256];
static int written[LANDS_WITHIN][MOST], writes, strange, settle, was_on, was_probing, touched, flags, beyond;
static long long lost_ns, off_ns;
static double base[MOST], position[MOST], moved[MOST];

/* The epoch that counts, and the one that is in the file. A start goes on further than by one, and no frame is taken while the
   file is further behind than that: otherwise an old frame could pass after the next start. */
#define EPOCHS_AHEAD 16
static volatile int kept_epoch, stored_epoch, stop;
static int was_behind;
static pthread_t keeper;
static int has_keeper;

static uint32_t crc32_of(const uint8_t *bytes, int length) {
    uint32_t c = 0xffffffffu;
    while (length--) c = crc_table[(c ^ *bytes++) & 0xff] ^ (c >> 8);
    return ~c;
}

/* Fletcher modulo 65535, started from the numbers of the machine and of the layout. */
static void checksum(const uint16_t *words, int count, uint16_t check[2]) {
    uint32_t sum = (machine + layout / 65535) % 65535, of_sums = layout % 65535;
    for (int i = 0; i < count; i++) { sum = (sum + words[i]) % 65535; of_sums = (of_sums + sum) % 65535; }
    check[0] = sum; check[1] = of_sums;
}

static int store(int number) {
    char beside[1024];
    if (snprintf(beside, sizeof beside, "%s.new", epoch_file) >= (int)sizeof beside) return -1;
    FILE *file = fopen(beside, "w");
    if (!file) return -1;
    int bad = fprintf(file, "%d\n", number) < 0 || fflush(file) || fsync(fileno(file));
    bad |= fclose(file) != 0;
    return bad ? -1 : rename(beside, epoch_file);
}

/* Keeps the epoch on a thread of its own: files have no place in the servo thread. */
static void *keep(void *unused) {
    while (!stop) {
        int now = kept_epoch;
        if (now != stored_epoch && store(now) == 0) stored_epoch = now;
        usleep(2000);
    }
    if (kept_epoch != stored_epoch) store(kept_epoch);
    return unused;
}

/* As `Settings` of the bridge in user space has it. What is published are words of 16 bits, and has to be what counts. */
static int settings_fit(void) {
    for (int i = 0; i < n; i++) {
        const int found[] = {step[i], limit[i], rate[i]}, most[] = {1000000, WORD, WORD};
        static const char *const names[] = {"a count of", "a limit of", "a rate of"}, *const units[] = {"nm or 1e-6 deg", "counts", "counts in a step"};
        for (int k = 0; k < 3; k++)
            if (found[k] < 1 || found[k] > most[k]) {
                rtapi_print_msg(RTAPI_MSG_ERR, "volcomp: axis %c: found %s %d %s, expected 1 to %d\n", axes[i], names[k], found[k], units[k], most[k]);
                return 0;
            }
    }
    if (step_scans < 1 || step_scans > WORD) {
        rtapi_print_msg(RTAPI_MSG_ERR, "volcomp: found %d cycles from step to step, expected 1 to %d: RATE_UM_PER_S or RATE_MDEG_PER_S is too small for the size of a count\n", step_scans, WORD);
        return 0;
    }
    if (hold_scans < 1 || hold_scans > WORD || time_out_scans < 2 * hold_scans || time_out_scans > WORD) {
        rtapi_print_msg(RTAPI_MSG_ERR, "volcomp: found a time-out of %d cycles (TIME_OUT_MS), expected at least twice the age of a frame (HOLD_MS), which is %d cycles, and less than 32768\n", time_out_scans, hold_scans);
        return 0;
    }
    return 1;
}

/* The epoch that was kept, 0 where none was: -1 where the file is there and holds none. */
static int kept_before(void) {
    long old;
    char more;
    FILE *file = fopen(epoch_file, "r");
    if (!file) {
        if (errno == ENOENT) return 0;
        rtapi_print_msg(RTAPI_MSG_ERR, "volcomp: %s cannot be read: %s\n", epoch_file, strerror(errno));
        return -1;
    }
    int found = fscanf(file, "%ld %c", &old, &more);
    fclose(file);
    if (found == 1 && old >= 0 && old <= 65535) return old;
    rtapi_print_msg(RTAPI_MSG_ERR, "volcomp: %s holds no epoch, expected a number from 0 to 65535: write there a number that the bridge has not had for long, such as the epoch that the gateway showed last and 1000\n", epoch_file);
    return -1;
}

EXTRA_SETUP() {
    static const char letters[] = "XYZABCUVW";
    struct sockaddr_in at;
    (void)__comp_inst; (void)prefix; (void)extra_arg;
    for (uint32_t i = 0; i < 256; i++) {
        uint32_t c = i;
        for (int k = 0; k < 8; k++) c = c & 1 ? 0xedb88320u ^ (c >> 1) : c >> 1;
        crc_table[i] = c;
    }
    n = strlen(axes); n_all = n + strlen(reads);
    if (n < 1 || n_all > MOST || joints < 1 || joints > 16 || machine < 0 || machine > 65534 || !*epoch_file) {
        rtapi_print_msg(RTAPI_MSG_ERR, "volcomp: found axes=%s reads=%s joints=%d machine=%d epoch_file=%s, expected 1 to 9 axes, 1 to 16 joints, a machine from 0 to 65534 and a file\n", axes, reads, joints, machine, epoch_file);
        return -EINVAL;
    }
    for (int i = 0; i < n; i++) {
        const char *found = strchr(letters, axes[i]);
        if (!found || strchr(axes, axes[i]) != axes + i) {
            rtapi_print_msg(RTAPI_MSG_ERR, "volcomp: found axes=%s, expected letters of axes, each once\n", axes);
            return -EINVAL;
        }
        layout = 10 * layout + (uint32_t)(found - letters) + 1;
    }
    if (!settings_fit()) return -EINVAL;
    int old = kept_before();
    if (old < 0) return -EINVAL;
    /* Further than one: of a run that ended between a time-out and its writing down. */
    kept_epoch = (old + EPOCHS_AHEAD) & 0xffff;
    if (store(kept_epoch)) {
        rtapi_print_msg(RTAPI_MSG_ERR, "volcomp: %s cannot be written: %s\n", epoch_file, strerror(errno));
        return -EIO;
    }
    stored_epoch = kept_epoch;
    memset(&at, 0, sizeof at);
    at.sin_family = AF_INET; at.sin_port = htons(port); at.sin_addr.s_addr = inet_addr(listen_on);
    fd = socket(AF_INET, SOCK_DGRAM, 0);
    if (fd < 0 || bind(fd, (struct sockaddr *)&at, sizeof at) || fcntl(fd, F_SETFL, O_NONBLOCK)) {
        rtapi_print_msg(RTAPI_MSG_ERR, "volcomp: UDP port %s:%d: %s\n", listen_on, port, strerror(errno));
        return -errno;
    }
    struct timespec now; clock_gettime(CLOCK_REALTIME, &now);
    run = (uint32_t)now.tv_nsec ^ (uint32_t)now.tv_sec * 2654435761u;
    has_keeper = pthread_create(&keeper, NULL, keep, NULL) == 0;
    return has_keeper ? 0 : -EAGAIN;
}

EXTRA_CLEANUP() {
    stop = 1;
    if (has_keeper) pthread_join(keeper, NULL);
    if (fd >= 0) close(fd);
}

static long long now_ns(void) {
    struct timespec now; clock_gettime(CLOCK_MONOTONIC, &now);
    return now.tv_sec * 1000000000LL + now.tv_nsec;
}

static void stand(const int *at) {
    memcpy(b.applied, at, sizeof b.applied); memcpy(b.from, at, sizeof b.from); memcpy(b.goal, at, sizeof b.goal);
    b.steps = b.done = 0;
}

static void next_epoch(void) { b.age++; kept_epoch = b.age; }

static void aim(const int *goal) {
    if (!memcmp(goal, b.goal, n * sizeof *goal)) return;
    memcpy(b.from, b.applied, sizeof b.from); memcpy(b.goal, goal, sizeof b.goal);
    b.done = b.steps = 0;
    for (int i = 0; i < n; i++) {
        unsigned steps = ((unsigned)abs(goal[i] - b.applied[i]) + rate[i] - 1) / rate[i];
        if (steps > b.steps) b.steps = steps;
    }
}

static void move_on(void) {
    if (b.done >= b.steps) return;
    b.done++;
    for (int i = 0; i < n; i++) {
        long long way = llabs((long long)b.goal[i] - b.from[i]);
        int moved = (int)((way * b.done + b.steps / 2) / b.steps);
        b.applied[i] = b.from[i] + (b.goal[i] >= b.from[i] ? moved : -moved);
    }
}

/* Whether the frame is taken: 1, judged before: 0, refused: minus the reason. */
static int judge(int mailbox, const uint16_t *words, int count, int *goal) {
    uint16_t check[2];
    int body = FRAME_HEAD + n;
    if (count < body + 2) return -R_CHECKSUM;
    checksum(words, body, check);
    if (check[0] != words[body] || check[1] != words[body + 1]) return -R_CHECKSUM;
    int again = b.found_any[mailbox] && b.found[mailbox][0] == words[1] && b.found[mailbox][1] == words[2];
    b.found_any[mailbox] = 1; b.found[mailbox][0] = words[1]; b.found[mailbox][1] = words[2];
    if (again) return 0;
    if (words[0] != b.age) return -R_EPOCH;
    if (!words[3] || (b.holder && words[3] != b.holder)) return -R_OWNER;
    if (b.holder && words[2] == b.sequence) return 0;
    if ((uint16_t)(b.tick - words[1]) > hold_scans) return -R_TICK;
    if (b.holder && (uint16_t)(words[2] - b.sequence) >= 32768) return -R_SEQUENCE;
    for (int i = 0; i < n; i++) {
        goal[i] = (int16_t)words[FRAME_HEAD + i];
        if (abs(goal[i]) > limit[i]) return -R_VALUE;
    }
    b.holder = words[3]; b.sequence = words[2]; b.refusal = R_NONE;
    return 1;
}

static uint16_t le16(const uint8_t *p) { return p[0] | p[1] << 8; }
static uint32_t le32(const uint8_t *p) { return le16(p) | (uint32_t)le16(p + 2) << 16; }

/* Datagrams that came: who listens, and the last frame of each since the last scan. */
static void receive(void) {
    uint8_t bytes[512];
    long long now = now_ns();
    for (int taken_now = 0; taken_now < 16; taken_now++) {
        struct sockaddr_in from; socklen_t size = sizeof from;
        int length = recvfrom(fd, bytes, sizeof bytes, 0, (struct sockaddr *)&from, &size);
        if (length < 0) break;
        if (length < 20 || memcmp(bytes, "VCLF\1", 5) || le32(bytes + length - 4) != crc32_of(bytes, length - 4)) continue;
        int kind = le16(bytes + 12), words = le16(bytes + 14);
        if (words > 40 || length != 20 + 2 * words || kind > 1 || (kind == 0 && words)) continue;
        if (kind == 1 && le16(bytes + 6) != machine) continue;
        struct sender *place = NULL;
        for (int i = 0; i < SENDERS; i++)
            if (senders[i].is_there && senders[i].at.sin_port == from.sin_port && senders[i].at.sin_addr.s_addr == from.sin_addr.s_addr) place = &senders[i];
        for (int i = 0; i < SENDERS && !place; i++)
            if (!senders[i].is_there) { place = &senders[i]; memset(place, 0, sizeof *place); }
        if (!place) continue;
        place->at = from; place->heard = now; place->is_there = 1;
        if (kind == 1) {
            place->has_frame = 1; place->words = words;
            for (int i = 0; i < words; i++) place->frame[i] = le16(bytes + 16 + 2 * i);
        }
    }
    for (int i = 0; i < SENDERS; i++)
        if (senders[i].is_there && now - senders[i].heard > LISTENS_NS) senders[i].is_there = 0;
}

/* Whether an axis has for long not had what is told of it: farther off than what moved on the way explains. */
static int is_off(int is_far, long period) {
    off_ns = is_far ? off_ns + (off_ns < OFF_NS ? period : 0) : 0;
    return off_ns >= OFF_NS;
}

FUNCTION(take) {
    int whole[MOST] = {0}, goal[MOST] = {0}, taken_goal[MOST] = {0};
    int has_goal = 0, all_homed = 1, same = 0;
    for (int i = 0; i < n; i++) whole[i] = (int)lround(request(i) * 1e6 / step[i]);
    if (!began) {
        b.age = kept_epoch;
        stand(whole);
        for (int i = 0; i < n; i++) base[i] = counts(i) - (double)whole[i] * step[i];
        memcpy(written[0], whole, sizeof whole); writes = 1;
        began = 1;
    }
    for (int i = 0; i < joints; i++) all_homed &= homed(i);
    flags = (estop_ok && user_ok ? 0 : ESTOP) | (enabled ? ENABLED : 0) | (all_homed ? HOMED : 0)
        | (limited ? LIMITED : 0) | (motion_type == 5 ? PROBING : 0);
    int is_on = enabled && all_homed;
    settle = is_on && was_on ? (settle > 0 ? settle - 1 : 0) : SETTLES;
    was_on = is_on;
    lost_ns = lost_ns > period ? lost_ns - period : 0;

    /* The control's request tells whether the counts are what it goes by: it swallows, clears and takes over offsets. */
    for (int k = 0; k < writes; k++) same |= !memcmp(whole, written[k], n * sizeof *whole);
    same |= !memcmp(whole, b.applied, n * sizeof *whole);
    strange = same ? 0 : strange + 1;
    if (strange > LANDS_WITHIN && is_on) {
        for (int i = 0; i < n; i++) {
            absorbed(i) += (b.applied[i] - whole[i]) * (double)step[i] * 1e-6;
            base[i] = counts(i) - (double)whole[i] * step[i];
        }
        rtapi_print_msg(RTAPI_MSG_ERR, "volcomp bridge: the control has lost an offset, or taken it into its position; nothing moves for a second, then the correction is ramped in anew\n");
        next_epoch();
        b.holder = b.sequence = b.silent = b.waited = 0; b.refusal = R_NONE;
        stand(whole);
        memcpy(written[0], whole, sizeof whole); writes = 1;
        strange = 0; lost_ns = LOST_NS;
    }
    /* Offsets are moved in these modes alone: elsewhere they stand, and jump when one of these comes back. */
    int stands = is_on && !coord_mode && !teleop_mode;
    int is_far = 0;
    for (int i = 0; i < n; i++) is_far |= !(fabs(eoffset(i) * 1e6 - (double)b.applied[i] * step[i]) <= OFF_BY + OFF_BY_COUNTS * (double)step[i] + moved[i]);
    if (is_off(is_on && is_far, period) || lost_ns || stands) flags |= LOST;
    holds = (flags & (ESTOP | LIMITED | LOST)) || !is_on || settle > 0 || strange > 0;
    /* What no word can tell is not told, and goes towards zero: that is the one movement while an offset counts as lost. */
    beyond = 0;
    for (int i = 0; i < n; i++) beyond |= b.applied[i] != (int16_t)b.applied[i];
    if (beyond) {
        holds = (flags & (ESTOP | LIMITED)) || !is_on || stands || settle > 0 || strange > 0;
        flags |= LOST;
    }
    /* G38.2 and G38.3 wait for a contact, G38.4 and G38.5 for its loss: the first change is what the control notes. */
    int is_probing = motion_type == 5;
    if (is_probing && was_probing && !!probe_input != touched)
        for (int i = 0; i < n; i++) probed_offset(i) = eoffset(i);
    was_probing = is_probing; touched = !!probe_input;

    receive();
    b.tick++;
    int is_behind = (uint16_t)(b.age - stored_epoch) >= EPOCHS_AHEAD;
    if (is_behind && !was_behind)
        rtapi_print_msg(RTAPI_MSG_ERR, "volcomp bridge: %s: the epoch in it is %d or more behind, and cannot be written; frames are refused until it is\n", epoch_file, EPOCHS_AHEAD);
    was_behind = is_behind;
    for (int i = 0; i < SENDERS; i++) {
        if (!senders[i].has_frame) continue;
        senders[i].has_frame = 0;
        if (is_behind) { b.refusal = R_EPOCH; continue; }
        int judged = judge(i, senders[i].frame, senders[i].words, goal);
        if (judged == 1) { has_goal = 1; taken++; memcpy(taken_goal, goal, sizeof goal); }
        else if (judged < 0) b.refusal = -judged;
    }
    if (has_goal) b.silent = 0;
    else if (b.silent < time_out_scans && ++b.silent == time_out_scans) {
        next_epoch(); b.holder = 0; has_goal = 1; memset(taken_goal, 0, sizeof taken_goal);
    }
    if (beyond) { has_goal = 1; memset(taken_goal, 0, sizeof taken_goal); }
    if (has_goal) aim(taken_goal);
    int before[MOST];
    memcpy(before, b.applied, sizeof before);
    if (!holds) {
        if (b.waited < 65535) b.waited++;
        if (b.waited >= step_scans) { b.waited = 0; move_on(); }
    }
    for (int i = 0; i < n; i++) {
        moved[i] += fabs((double)b.applied[i] - before[i]) * step[i] - moved[i] * (period < WAY_NS ? period / WAY_NS : 1.0);
        counts(i) = (int)lround(base[i] + (double)b.applied[i] * step[i]);
    }
    for (int k = LANDS_WITHIN - 1; k > 0; k--) memcpy(written[k], written[k - 1], sizeof written[k]);
    memcpy(written[0], b.applied, sizeof written[0]);
    if (writes < LANDS_WITHIN) writes++;
    owner = b.holder; epoch = b.age; refused = b.refusal;
}

static uint8_t *put(uint8_t *p, const void *from, int size) { memcpy(p, from, size); return p + size; }
static uint8_t *put16(uint8_t *p, uint16_t value) { return put(p, &value, 2); }
static uint8_t *put32(uint8_t *p, uint32_t value) { return put(p, &value, 4); }

/* All computers that LinuxCNC runs on are little-endian. */
FUNCTION(tell) {
    uint8_t bytes[512], *p = bytes;
    uint16_t words[REPORT_HEAD + 3 * MOST + 2];
    int count = 0;
    if (!began) return;
    int fits = 1;
    for (int i = 0; i < n; i++) fits &= b.applied[i] == (int16_t)b.applied[i];
    if (fits) {
        words[count++] = b.age; words[count++] = b.tick; words[count++] = b.holder; words[count++] = b.sequence;
        words[count++] = b.refusal; words[count++] = step_scans; words[count++] = hold_scans; words[count++] = time_out_scans;
        for (int i = 0; i < n; i++) { words[count++] = b.applied[i]; words[count++] = limit[i]; words[count++] = rate[i]; }
        checksum(words, count, words + count);
        count += 2;
    }
    sequence++;
    p = put(p, "VCLS\1", 5); *p++ = n_all;
    p = put16(p, machine); p = put32(p, run); p = put32(p, sequence);
    p = put16(p, flags); p = put16(p, count);
    uint64_t now = now_ns();
    p = put(p, &now, 8); p = put32(p, period); p = put32(p, 0);
    for (int i = 0; i < n_all; i++) {
        double at = pos_cmd(i), velocity = (at - position[i]) * 1e9 / period;
        int64_t offset = i < n ? llround(eoffset(i) * 1e6) : 0;
        position[i] = at;
        p = put32(p, (uint8_t)(i < n ? axes[i] : reads[i - n]));
        p = put32(p, i < n ? step[i] : 1);
        p = put(p, &at, 8); p = put(p, &velocity, 8); p = put(p, &offset, 8);
    }
    p = put(p, words, 2 * count);
    p = put32(p, crc32_of(bytes, p - bytes));
    for (int i = 0; i < SENDERS; i++)
        if (senders[i].is_there) (void)!sendto(fd, bytes, p - bytes, 0, (struct sockaddr *)&senders[i].at, sizeof senders[i].at);
}
