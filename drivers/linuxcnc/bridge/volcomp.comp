component volcomp "Bridge to a volcomp gateway in the servo thread: external offsets behind a barrier.";
description """
\\fBtake\\fR goes before motion-controller: it takes the frames that came, lets the barrier decide, and writes the counts.
\\fBtell\\fR goes after it: it sends the state of this cycle to those who listen. Settings are given when it is loaded, and
refused then; volcomp.tcl does all of it from the section [VOLCOMP] of the INI file.
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
pin out u32 refused "why the last frame was not taken: the numbers of the protocol";
pin out u32 taken "frames that were taken";
pin out u32 forged "datagrams that are no commands with the code of the key";
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
include <sys/stat.h>;
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
static char *key_file = "";           RTAPI_MP_STRING(key_file, "file with the key that the gateway has, too");
static int port = 47001;              RTAPI_MP_INT(port, "UDP port");
static int machine = 0;               RTAPI_MP_INT(machine, "number of the machine");
static int joints = 3;                RTAPI_MP_INT(joints, "number of joints");
#define MOST_AXES 9
#define MOST_JOINTS 16
#define MOST_MACHINE 65534
static int step[MOST_AXES];           RTAPI_MP_ARRAY_INT(step, 9, "size of a count, nm or millionths of a degree");
static int limit[MOST_AXES];          RTAPI_MP_ARRAY_INT(limit, 9, "largest correction, counts");
static int rate[MOST_AXES];           RTAPI_MP_ARRAY_INT(rate, 9, "largest movement in a step, counts");
static int step_scans = 1;            RTAPI_MP_INT(step_scans, "cycles from step to step");
static int hold_scans = 100;          RTAPI_MP_INT(hold_scans, "largest age of a frame, cycles");
static int time_out_scans = 300;      RTAPI_MP_INT(time_out_scans, "cycles without a frame after which the correction goes to zero");

/* The barrier: words of 16 bits before those of the axes, and the largest value of one that has a sign. */
#define FRAME_HEAD 4
#define REPORT_HEAD 8
#define MOST_COUNTS 32767
/* Datagrams: bytes besides the words of a command, those of the code at the end, most words, and how many are read in a cycle. */
#define COMMAND_BYTES 28
#define MAC_BYTES 8
#define MOST_WORDS 40
#define DATAGRAM_BYTES 512
#define DATAGRAMS_A_CYCLE 16
enum { KIND_LISTEN, KIND_FRAME };
/* Senders that hear states, and for how long without a word of theirs. */
#define SENDERS 4
#define LISTENS_NS 1000000000LL
/* Cycles within which a change of the counts must be seen in LinuxCNC's request. */
#define LANDS_WITHIN 5
/* Cycles for which nothing moves after the machine was switched on. */
#define SETTLES 20
/* How long nothing moves after an offset was lost. */
#define LOST_NS 1000000000LL
/* How far an offset may be off besides what its value moved in the time of the way, and for how long: some counts, and what the
   planner leaves where it stops (nm or millionths of a degree). */
#define OFF_BY_COUNTS 3
#define OFF_BY 10.0
#define WAY_NS 250000000.0
#define OFF_NS 500000000LL
/* Parts of a unit (mm or degree) in the unit of steps and offsets. */
#define NANO 1e6
/* motion.motion-type while LinuxCNC probes. */
#define MOTION_IS_PROBING 5
/* Flags and refusals by the numbers of the protocol: its tables in drivers/linuxcnc/README.md. */
enum { EMERGENCY_STOP = 1, ENABLED = 2, HOMED = 4, LIMITED = 8, PROBING = 16, LOST = 32 };
enum { REFUSED_NONE, REFUSED_CHECKSUM, REFUSED_EPOCH, REFUSED_TICK, REFUSED_OWNER, REFUSED_SEQUENCE, REFUSED_VALUE };

/* Pins are macros of their names, so nothing else here can be called owner, epoch, counts, request, holds and so on. Functions
   that use pins are given those of the component. */
#define PINS struct __comp_state *__comp_inst

/* The barrier: whole counts, words of 16 bits, time in scans. */
static struct {
    uint16_t epoch_now, tick, owner_now, sequence, refusal, scans_since_step, scans_without_frame;
    /* Tick and sequence of the last frame that was judged, of each sender: the same one again is not judged twice. */
    int has_judged[SENDERS]; uint16_t judged[SENDERS][2];
    /* The line on which all axes move: from where, to where, in how many steps, and how many are done. */
    int applied[MOST_AXES], line_from[MOST_AXES], line_to[MOST_AXES];
    unsigned line_steps, steps_done;
} barrier;
static int axis_count, told_count, has_begun;
static uint32_t layout;

static struct sender { struct sockaddr_in address; long long heard_ns; int is_there, has_frame, word_count; uint16_t frame[MOST_WORDS]; } senders[SENDERS];
static int udp = -1;
static uint32_t run_number, states_sent;
/* The sender whose frame was accepted last: a place is kept for it. Those who get the next state alone, without a place. */
static struct sockaddr_in writer, once[DATAGRAMS_A_CYCLE];
static int once_count;
/* Read at the start, constant afterwards. */
static uint64_t key[2];

/* What was applied in the last cycles: LinuxCNC's request may be any of these, since the last ones are still on their way. */
static int sent[LANDS_WITHIN][MOST_AXES], sent_count;
/* Cycles in which the request was none of them. */
static int cycles_unknown;
static int settle_cycles_left, was_on, was_probing, was_touching, flags, is_beyond_words;
static long long lost_left_ns, off_for_ns;
/* LinuxCNC's counts at which those of the barrier are zero; positions of the cycle before; what moved in the time of the way. */
static double counts_at_zero[MOST_AXES], last_position[MOST_AXES], moved_lately[MOST_AXES];

/* The epoch that counts, which the servo thread writes, and the one that is in the file, which the keeper writes, a thread of its
   own: files have no place in the servo thread. A start goes on further than by one, and no frame is taken while the file is
   further behind than that: otherwise an old frame could pass after the next start. Each is one word without a lock: written
   (released) after what it stands for, read (acquired) before what depends on it, so that a frame is judged only behind a file that is on the disk. */
#define EPOCHS_AHEAD 16
static int kept_epoch, stored_epoch, keeper_ends;
static int was_behind, has_keeper;
static pthread_t keeper;

static int seen(const int *word) { return __atomic_load_n(word, __ATOMIC_ACQUIRE); }
static void show(int *word, int value) { __atomic_store_n(word, value, __ATOMIC_RELEASE); }

/* SipHash-2-4 with 64 bits of output (Aumasson and Bernstein, "SipHash: a fast short-input PRF", 2012): the code of every datagram. */
static uint64_t rotated(uint64_t x, int by) { return x << by | x >> (64 - by); }

static void sip_rounds(uint64_t v[4], int rounds) {
    while (rounds--) {
        v[0] += v[1]; v[1] = rotated(v[1], 13) ^ v[0]; v[0] = rotated(v[0], 32);
        v[2] += v[3]; v[3] = rotated(v[3], 16) ^ v[2];
        v[0] += v[3]; v[3] = rotated(v[3], 21) ^ v[0];
        v[2] += v[1]; v[1] = rotated(v[1], 17) ^ v[2]; v[2] = rotated(v[2], 32);
    }
}

static uint64_t mac(const uint8_t *bytes, int length) {
    uint64_t v[4] = {key[0] ^ 0x736f6d6570736575u, key[1] ^ 0x646f72616e646f6du, key[0] ^ 0x6c7967656e657261u, key[1] ^ 0x7465646279746573u};
    uint64_t word, last = (uint64_t)length << 56;
    int whole = length & ~7;
    for (int i = 0; i < whole; i += 8) { memcpy(&word, bytes + i, 8); v[3] ^= word; sip_rounds(v, 2); v[0] ^= word; }
    for (int i = whole; i < length; i++) last |= (uint64_t)bytes[i] << 8 * (i - whole);
    v[3] ^= last; sip_rounds(v, 2); v[0] ^= last;
    v[2] ^= 0xff; sip_rounds(v, 4);
    return v[0] ^ v[1] ^ v[2] ^ v[3];
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

/* Writes the epoch into its file whenever it has moved on. */
static void *keep(void *unused) {
    while (!seen(&keeper_ends)) {
        int now = seen(&kept_epoch);
        if (now != seen(&stored_epoch) && store(now) == 0) show(&stored_epoch, now);
        usleep(2000);
    }
    int last = seen(&kept_epoch);
    if (last != seen(&stored_epoch)) store(last);
    return unused;
}

/* Whether a setting is in its range; told where it is not. The names are those of the component's settings, and of the INI file. */
static int is_within(const char *name, const char *of_axis, long found, const char *unit, long least, long most) {
    if (found >= least && found <= most) return 1;
    rtapi_print_msg(RTAPI_MSG_ERR, "volcomp: %s%s: found %ld%s, expected %ld to %ld\n", name, of_axis, found, unit, least, most);
    return 0;
}

/* What is published are words of 16 bits, and has to be what counts. */
static int settings_fit(void) {
    for (int i = 0; i < axis_count; i++) {
        char of_axis[] = " of axis X";
        of_axis[sizeof of_axis - 2] = axes[i];
        if (!is_within("step (STEP_NM, STEP_UDEG)", of_axis, step[i], " nm or 1e-6 deg", 1, 1000000)) return 0;
        if (!is_within("limit (LIMIT_UM, LIMIT_MDEG)", of_axis, limit[i], " counts", 1, MOST_COUNTS)) return 0;
        if (!is_within("rate (RATE_UM_PER_S, RATE_MDEG_PER_S)", of_axis, rate[i], " counts in a step", 1, MOST_COUNTS)) return 0;
    }
    /* So many cycles are needed where the rate is too small for the size of a count. */
    return is_within("step_scans (RATE_UM_PER_S, RATE_MDEG_PER_S)", "", step_scans, " cycles from count to count", 1, MOST_COUNTS)
        && is_within("hold_scans (HOLD_MS)", "", hold_scans, " cycles", 1, MOST_COUNTS / 2)
        && is_within("time_out_scans (TIME_OUT_MS)", "", time_out_scans, " cycles", 2 * hold_scans, MOST_COUNTS);
}

/* The axes, each once and known, by their letters; counts them, and numbers their layout. */
static int axes_fit(void) {
    static const char letters[] = "XYZABCUVW";
    axis_count = strlen(axes); told_count = axis_count + strlen(reads);
    if (!is_within("axes (AXES)", "", axis_count, " axes", 1, MOST_AXES)) return 0;
    if (!is_within("reads (READS)", "", told_count - axis_count, " axes", 0, MOST_AXES - axis_count)) return 0;
    layout = 0;
    for (int i = 0; i < told_count; i++) {
        char letter = i < axis_count ? axes[i] : reads[i - axis_count];
        const char *found = strchr(letters, letter);
        int times = 0;
        for (int k = 0; k < told_count; k++) times += letter == (k < axis_count ? axes[k] : reads[k - axis_count]);
        if (!found || times != 1) {
            rtapi_print_msg(RTAPI_MSG_ERR, "volcomp: axes (AXES) and reads (READS): found %s and %s, expected letters of %s, each once\n", axes, reads, letters);
            return 0;
        }
        if (i < axis_count) layout = 10 * layout + (uint32_t)(found - letters) + 1;
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

static int hex_digit(char c) {
    return c >= '0' && c <= '9' ? c - '0' : c >= 'a' && c <= 'f' ? c - 'a' + 10 : c >= 'A' && c <= 'F' ? c - 'A' + 10 : -1;
}

/* Reads the key by the rule of the gateway: 32 hexadecimal digits, blanks after them, in a file that only its owner may read. */
static int read_key(void) {
    char text[64];
    struct stat status;
    FILE *file = fopen(key_file, "r");
    if (!file || fstat(fileno(file), &status)) {
        rtapi_print_msg(RTAPI_MSG_ERR, "volcomp: key_file (KEY_FILE): %s cannot be read: %s\n", key_file, strerror(errno));
        if (file) fclose(file);
        return -EIO;
    }
    int length = fread(text, 1, sizeof text, file), bad = length < 32 || length == sizeof text;
    fclose(file);
    if (status.st_mode & 077) {
        rtapi_print_msg(RTAPI_MSG_ERR, "volcomp: key_file (KEY_FILE): %s: found mode %03o, expected 600\n", key_file, (unsigned)status.st_mode & 0777);
        return -EPERM;
    }
    uint8_t bytes[16] = {0};
    for (int i = 0; i < length && !bad; i++) {
        int digit = hex_digit(text[i]);
        if (i >= 32) bad = !text[i] || !strchr(" \t\r\n", text[i]);
        else if (digit < 0) bad = 1;
        else bytes[i / 2] |= digit << (i % 2 ? 0 : 4);
    }
    if (bad) {
        rtapi_print_msg(RTAPI_MSG_ERR, "volcomp: key_file (KEY_FILE): %s: expected 32 hexadecimal digits and nothing else\n", key_file);
        return -EINVAL;
    }
    memcpy(key, bytes, sizeof key);
    return 0;
}

/* Goes on from the epoch that was kept, further than by one: a run may have ended between a time-out and its writing down. */
static int begin_epoch(void) {
    int before = kept_before();
    if (before < 0) return -EINVAL;
    int now = (before + EPOCHS_AHEAD) & 0xffff;
    if (store(now)) {
        rtapi_print_msg(RTAPI_MSG_ERR, "volcomp: epoch_file (EPOCH_FILE): %s cannot be written: %s\n", epoch_file, strerror(errno));
        return -EIO;
    }
    show(&kept_epoch, now); show(&stored_epoch, now);
    return 0;
}

static int open_socket(void) {
    struct sockaddr_in address;
    memset(&address, 0, sizeof address);
    address.sin_family = AF_INET; address.sin_port = htons(port);
    if (!inet_aton(listen_on, &address.sin_addr)) {
        rtapi_print_msg(RTAPI_MSG_ERR, "volcomp: listen_on (LISTEN): found %s, expected an IPv4 address such as 127.0.0.1\n", listen_on);
        return -EINVAL;
    }
    udp = socket(AF_INET, SOCK_DGRAM, 0);
    if (udp < 0 || bind(udp, (struct sockaddr *)&address, sizeof address) || fcntl(udp, F_SETFL, O_NONBLOCK)) {
        int why = errno;
        rtapi_print_msg(RTAPI_MSG_ERR, "volcomp: UDP port %s:%d: %s\n", listen_on, port, strerror(why));
        return -why;
    }
    return 0;
}

EXTRA_SETUP() {
    (void)__comp_inst; (void)prefix; (void)extra_arg;
    if (!axes_fit() || !is_within("joints ([KINS]JOINTS)", "", joints, "", 1, MOST_JOINTS)
        || !is_within("machine (MACHINE)", "", machine, "", 0, MOST_MACHINE)
        || !is_within("port (PORT)", "", port, "", 0, 65535)) return -EINVAL;
    if (!*epoch_file) {
        rtapi_print_msg(RTAPI_MSG_ERR, "volcomp: epoch_file (EPOCH_FILE): found none, expected a file that keeps the epoch\n");
        return -EINVAL;
    }
    if (!settings_fit()) return -EINVAL;
    int failed = read_key();
    if (!failed) failed = begin_epoch();
    if (!failed) failed = open_socket();
    if (failed) return failed;
    struct timespec now; clock_gettime(CLOCK_REALTIME, &now);
    run_number = (uint32_t)now.tv_nsec ^ (uint32_t)now.tv_sec * 2654435761u;
    has_keeper = pthread_create(&keeper, NULL, keep, NULL) == 0;
    return has_keeper ? 0 : -EAGAIN;
}

EXTRA_CLEANUP() {
    show(&keeper_ends, 1);
    if (has_keeper) pthread_join(keeper, NULL);
    if (udp >= 0) close(udp);
}

static long long now_ns(void) {
    struct timespec now; clock_gettime(CLOCK_MONOTONIC, &now);
    return now.tv_sec * 1000000000LL + now.tv_nsec;
}

/* The axes stand here, and there is no line. */
static void stand(const int *at) {
    memcpy(barrier.applied, at, sizeof barrier.applied);
    memcpy(barrier.line_from, at, sizeof barrier.line_from);
    memcpy(barrier.line_to, at, sizeof barrier.line_to);
    barrier.line_steps = barrier.steps_done = 0;
}

static void next_epoch(void) { barrier.epoch_now++; show(&kept_epoch, barrier.epoch_now); }

/* Begins a line to other values; a line to the same values goes on. */
static void aim(const int *goal) {
    if (!memcmp(goal, barrier.line_to, axis_count * sizeof *goal)) return;
    memcpy(barrier.line_from, barrier.applied, sizeof barrier.line_from);
    memcpy(barrier.line_to, goal, sizeof barrier.line_to);
    barrier.steps_done = barrier.line_steps = 0;
    for (int i = 0; i < axis_count; i++) {
        unsigned steps = ((unsigned)abs(goal[i] - barrier.applied[i]) + rate[i] - 1) / rate[i];
        if (steps > barrier.line_steps) barrier.line_steps = steps;
    }
}

static void move_on(void) {
    if (barrier.steps_done >= barrier.line_steps) return;
    barrier.steps_done++;
    for (int i = 0; i < axis_count; i++) {
        long long way = llabs((long long)barrier.line_to[i] - barrier.line_from[i]);
        int gone = (int)((way * barrier.steps_done + barrier.line_steps / 2) / barrier.line_steps);
        barrier.applied[i] = barrier.line_from[i] + (barrier.line_to[i] >= barrier.line_from[i] ? gone : -gone);
    }
}

/* Whether a frame (epoch, tick, sequence, owner, values, checksum) is taken: 1, judged before: 0, refused: minus the reason. */
static int judge(int mailbox, const uint16_t *words, int word_count, int *goal) {
    uint16_t check[2], frame_epoch = words[0], frame_tick = words[1], frame_sequence = words[2], frame_owner = words[3];
    int body = FRAME_HEAD + axis_count;
    if (word_count < body + 2) return -REFUSED_CHECKSUM;
    checksum(words, body, check);
    if (check[0] != words[body] || check[1] != words[body + 1]) return -REFUSED_CHECKSUM;
    uint16_t *judged = barrier.judged[mailbox];
    int again = barrier.has_judged[mailbox] && judged[0] == frame_tick && judged[1] == frame_sequence;
    barrier.has_judged[mailbox] = 1; judged[0] = frame_tick; judged[1] = frame_sequence;
    if (again) return 0;
    if (frame_epoch != barrier.epoch_now) return -REFUSED_EPOCH;
    if (!frame_owner || (barrier.owner_now && frame_owner != barrier.owner_now)) return -REFUSED_OWNER;
    if (barrier.owner_now && frame_sequence == barrier.sequence) return 0;
    if ((uint16_t)(barrier.tick - frame_tick) > hold_scans) return -REFUSED_TICK;
    if (barrier.owner_now && (uint16_t)(frame_sequence - barrier.sequence) >= 32768) return -REFUSED_SEQUENCE;
    for (int i = 0; i < axis_count; i++) {
        goal[i] = (int16_t)words[FRAME_HEAD + i];
        if (abs(goal[i]) > limit[i]) return -REFUSED_VALUE;
    }
    barrier.owner_now = frame_owner; barrier.sequence = frame_sequence; barrier.refusal = REFUSED_NONE;
    return 1;
}

static uint16_t le16(const uint8_t *p) { return p[0] | p[1] << 8; }
static uint32_t le32(const uint8_t *p) { return le16(p) | (uint32_t)le16(p + 2) << 16; }

static uint64_t le64(const uint8_t *p) { return le32(p) | (uint64_t)le32(p + 4) << 32; }

static int is_same(const struct sockaddr_in *a, const struct sockaddr_in *b) {
    return a->sin_port == b->sin_port && a->sin_addr.s_addr == b->sin_addr.s_addr;
}

/* The place of a sender, a new one where there is room: otherwise none. The last vacant place is for the writer or, while it has none,
   for one that sends frames: however many listen, they leave the owner a place. */
static struct sender *place_of(const struct sockaddr_in *from, int has_frame) {
    struct sender *vacant = NULL;
    int vacancies = 0, keeps_one = !has_frame && !is_same(from, &writer);
    for (int i = 0; i < SENDERS; i++) {
        struct sender *known = &senders[i];
        if (!known->is_there) { vacancies++; if (!vacant) vacant = known; continue; }
        if (is_same(&known->address, from)) return known;
        if (is_same(&known->address, &writer)) keeps_one = 0;
    }
    if (!vacant || (vacancies == 1 && keeps_one)) return NULL;
    memset(vacant, 0, sizeof *vacant);
    return vacant;
}

/* A command of our key: without it nothing of a datagram counts. */
static int is_command(const uint8_t *bytes, int length) {
    return length >= COMMAND_BYTES && !memcmp(bytes, "VCLF\2", 5) && le64(bytes + length - MAC_BYTES) == mac(bytes, length - MAC_BYTES);
}

/* Whether a command answers a state of this run that is a second old at most. One that was recorded and is sent again later does not. */
static int is_fresh(const uint8_t *bytes, long period) {
    long long age = (uint32_t)(states_sent - le32(bytes + 12));
    return le32(bytes + 8) == run_number && age * period <= LISTENS_NS;
}

/* Datagrams that came: who listens, and the last frame of each since the last scan. A command that is not fresh gets one state, which the
   next command can answer. */
static void receive(PINS, long period) {
    uint8_t bytes[DATAGRAM_BYTES];
    long long now = now_ns();
    for (int heard = 0; heard < DATAGRAMS_A_CYCLE; heard++) {
        struct sockaddr_in from; socklen_t size = sizeof from;
        int length = recvfrom(udp, bytes, sizeof bytes, 0, (struct sockaddr *)&from, &size);
        if (length < 0) break;
        if (!is_command(bytes, length)) { forged++; continue; }
        int kind = le16(bytes + 16), words = le16(bytes + 18);
        if (words > MOST_WORDS || length != COMMAND_BYTES + 2 * words || kind > KIND_FRAME || (kind == KIND_LISTEN && words)) continue;
        if (kind == KIND_FRAME && le16(bytes + 6) != machine) continue;
        struct sender *place = is_fresh(bytes, period) ? place_of(&from, kind == KIND_FRAME) : NULL;
        if (!place) { if (once_count < DATAGRAMS_A_CYCLE) once[once_count++] = from; continue; }
        place->address = from; place->heard_ns = now; place->is_there = 1;
        if (kind == KIND_FRAME) {
            place->has_frame = 1; place->word_count = words;
            for (int i = 0; i < words; i++) place->frame[i] = le16(bytes + 20 + 2 * i);
        }
    }
    for (int i = 0; i < SENDERS; i++)
        if (senders[i].is_there && now - senders[i].heard_ns > LISTENS_NS) senders[i].is_there = 0;
}

/* The barrier begins at what LinuxCNC is asked for, and asks for nothing else: only changes of the counts move an axis. */
static void begin_at(PINS, const int *asked) {
    stand(asked);
    for (int i = 0; i < axis_count; i++) counts_at_zero[i] = counts(i) - (double)asked[i] * step[i];
    memcpy(sent[0], asked, sizeof sent[0]); sent_count = 1;
}

/* What the control is doing, and whether it is on: its flags for the state. */
static int look_at_control(PINS) {
    int all_homed = 1;
    for (int i = 0; i < joints; i++) all_homed &= homed(i);
    flags = (estop_ok && user_ok ? 0 : EMERGENCY_STOP) | (enabled ? ENABLED : 0) | (all_homed ? HOMED : 0)
        | (motion_type == MOTION_IS_PROBING ? PROBING : 0);
    int is_on = enabled && all_homed;
    if (!is_on || !was_on) settle_cycles_left = SETTLES;
    else if (settle_cycles_left > 0) settle_cycles_left--;
    was_on = is_on;
    return is_on;
}

/* LinuxCNC's request tells whether the counts are what it goes by: it swallows, clears and takes over offsets. Where it is none of
   what was sent for some cycles, the barrier begins anew from it. */
static void watch_request(PINS, const int *asked, int is_on) {
    size_t size = axis_count * sizeof *asked;
    int is_known = !memcmp(asked, barrier.applied, size);
    for (int k = 0; k < sent_count; k++) is_known |= !memcmp(asked, sent[k], size);
    cycles_unknown = is_known ? 0 : cycles_unknown + 1;
    if (cycles_unknown <= LANDS_WITHIN || !is_on) return;
    for (int i = 0; i < axis_count; i++) absorbed(i) += (barrier.applied[i] - asked[i]) * (double)step[i] / NANO;
    rtapi_print_msg(RTAPI_MSG_ERR, "volcomp bridge: the control has lost an offset, or taken it into its position; nothing moves for a second, then the correction is ramped in anew\n");
    next_epoch();
    barrier.owner_now = barrier.sequence = barrier.scans_without_frame = barrier.scans_since_step = 0;
    barrier.refusal = REFUSED_NONE;
    begin_at(__comp_inst, asked);
    cycles_unknown = 0; lost_left_ns = LOST_NS;
}

/* Whether an axis has not what is told of it: farther off than what moved on the way explains. */
static int is_any_far(PINS) {
    int is_far = 0;
    for (int i = 0; i < axis_count; i++) {
        double off = fabs(eoffset(i) * NANO - (double)barrier.applied[i] * step[i]);
        /* What is no number is far. */
        is_far |= !(off <= OFF_BY + OFF_BY_COUNTS * (double)step[i] + moved_lately[i]);
    }
    return is_far;
}

/* Whether an axis has been far for long. */
static int is_off(int is_far, int is_on, long period) {
    off_for_ns = is_on && is_far ? off_for_ns + (off_for_ns < OFF_NS ? period : 0) : 0;
    return off_for_ns >= OFF_NS;
}

/* Whether all axes stand still in this cycle; adds what is lost to the flags. */
static int must_hold(PINS, int is_on, long period) {
    int is_far = is_any_far(__comp_inst);
    /* LinuxCNC tells a cut also where it cut nothing, and from manual mode at a limit still in a program far from it. */
    if (limited && is_far) flags |= LIMITED;
    /* LinuxCNC moves offsets in these modes alone: elsewhere they stand, and jump when one of these comes back. */
    int stands = is_on && !coord_mode && !teleop_mode;
    int waits = (flags & (EMERGENCY_STOP | LIMITED)) || !is_on || stands || settle_cycles_left > 0 || cycles_unknown > 0;
    if (is_off(is_far, is_on, period) || lost_left_ns || stands) flags |= LOST;
    /* What no word can tell is not told, and goes towards zero: that is the one movement while an offset counts as lost. */
    is_beyond_words = 0;
    for (int i = 0; i < axis_count; i++) is_beyond_words |= barrier.applied[i] != (int16_t)barrier.applied[i];
    int is_lost = flags & LOST;
    if (is_beyond_words) flags |= LOST;
    return waits || (is_lost && !is_beyond_words);
}

/* The offset at the contact of a probe: G38.2 and G38.3 wait for a contact, G38.4 and G38.5 for its loss, and the first change is
   what the control notes. */
static void note_contact(PINS) {
    int is_probing = motion_type == MOTION_IS_PROBING, is_touching = !!probe_input;
    if (is_probing && was_probing && is_touching != was_touching)
        for (int i = 0; i < axis_count; i++) probed_offset(i) = eoffset(i);
    was_probing = is_probing; was_touching = is_touching;
}

/* Judges the frames that came. Whether one was taken, whose values are the goal then. */
static int judge_frames(PINS, int *goal) {
    int has_goal = 0, found[MOST_AXES] = {0};
    int is_behind = (uint16_t)(barrier.epoch_now - seen(&stored_epoch)) >= EPOCHS_AHEAD;
    if (is_behind && !was_behind)
        rtapi_print_msg(RTAPI_MSG_ERR, "volcomp bridge: %s: the epoch in it is %d or more behind, and cannot be written; frames are refused until it is\n", epoch_file, EPOCHS_AHEAD);
    was_behind = is_behind;
    for (int i = 0; i < SENDERS; i++) {
        if (!senders[i].has_frame) continue;
        senders[i].has_frame = 0;
        if (is_behind) { barrier.refusal = REFUSED_EPOCH; continue; }
        int judged = judge(i, senders[i].frame, senders[i].word_count, found);
        if (judged == 1) { has_goal = 1; taken++; writer = senders[i].address; memcpy(goal, found, sizeof found); }
        else if (judged < 0) barrier.refusal = -judged;
    }
    return has_goal;
}

/* One scan of the barrier: frames, the time-out without one, and a step on the line where the axes may move. */
static void scan_barrier(PINS, int is_held) {
    int goal[MOST_AXES] = {0};
    barrier.tick++;
    int has_goal = judge_frames(__comp_inst, goal);
    if (has_goal) barrier.scans_without_frame = 0;
    else if (barrier.scans_without_frame < time_out_scans && ++barrier.scans_without_frame == time_out_scans) {
        next_epoch(); barrier.owner_now = 0; has_goal = 1;
    }
    if (is_beyond_words) { has_goal = 1; memset(goal, 0, sizeof goal); }
    if (has_goal) aim(goal);
    if (is_held) return;
    if (barrier.scans_since_step < 65535) barrier.scans_since_step++;
    if (barrier.scans_since_step >= step_scans) { barrier.scans_since_step = 0; move_on(); }
}

/* What is applied goes to LinuxCNC, and is remembered for as long as it may be on its way. */
static void write_counts(PINS, const int *before, long period) {
    double forgotten = period < WAY_NS ? period / WAY_NS : 1.0;
    for (int i = 0; i < axis_count; i++) {
        moved_lately[i] += fabs((double)barrier.applied[i] - before[i]) * step[i] - moved_lately[i] * forgotten;
        counts(i) = (int)lround(counts_at_zero[i] + (double)barrier.applied[i] * step[i]);
    }
    for (int k = LANDS_WITHIN - 1; k > 0; k--) memcpy(sent[k], sent[k - 1], sizeof sent[k]);
    memcpy(sent[0], barrier.applied, sizeof sent[0]);
    if (sent_count < LANDS_WITHIN) sent_count++;
}

/* Nothing here allocates or waits. Messages: on uspace rtapi_print_msg formats on the stack of a real-time thread and puts the text
   into a queue without a lock, which drops what is too much and which another thread prints (src/rtapi/uspace_rtapi_app.cc,
   default_rtapi_msg_handler: boost::lockfree::queue; so it is in the rtapi_app of Debian 12); motmod puts errors into a ring in
   shared memory, too, without a lock (src/emc/motion/motion.c, emc_message_handler). They are said once, when something begins. */
FUNCTION(take) {
    int asked[MOST_AXES] = {0}, before[MOST_AXES];
    for (int i = 0; i < axis_count; i++) asked[i] = (int)lround(request(i) * NANO / step[i]);
    if (!has_begun) {
        barrier.epoch_now = seen(&kept_epoch);
        begin_at(__comp_inst, asked);
        has_begun = 1;
    }
    int is_on = look_at_control(__comp_inst);
    lost_left_ns = lost_left_ns > period ? lost_left_ns - period : 0;
    watch_request(__comp_inst, asked, is_on);
    holds = must_hold(__comp_inst, is_on, period);
    note_contact(__comp_inst);
    receive(__comp_inst, period);
    memcpy(before, barrier.applied, sizeof before);
    scan_barrier(__comp_inst, holds);
    write_counts(__comp_inst, before, period);
    owner = barrier.owner_now; epoch = barrier.epoch_now; refused = barrier.refusal;
}

static uint8_t *put(uint8_t *p, const void *from, int size) { memcpy(p, from, size); return p + size; }
static uint8_t *put16(uint8_t *p, uint16_t value) { return put(p, &value, 2); }
static uint8_t *put32(uint8_t *p, uint32_t value) { return put(p, &value, 4); }

/* The words of the report; none while an axis stands where no word can tell it. How many there are. */
static int report(uint16_t *words) {
    int count = 0;
    for (int i = 0; i < axis_count; i++) if (barrier.applied[i] != (int16_t)barrier.applied[i]) return 0;
    words[count++] = barrier.epoch_now; words[count++] = barrier.tick; words[count++] = barrier.owner_now; words[count++] = barrier.sequence;
    words[count++] = barrier.refusal; words[count++] = step_scans; words[count++] = hold_scans; words[count++] = time_out_scans;
    for (int i = 0; i < axis_count; i++) { words[count++] = barrier.applied[i]; words[count++] = limit[i]; words[count++] = rate[i]; }
    checksum(words, count, words + count);
    return count + 2;
}

static void send_to(const struct sockaddr_in *to, const uint8_t *bytes, int length) {
    /* One that is lost is followed by the next. */
    (void)!sendto(udp, bytes, length, 0, (const struct sockaddr *)to, sizeof *to);
}

/* All computers that LinuxCNC runs on are little-endian. */
FUNCTION(tell) {
    uint8_t bytes[DATAGRAM_BYTES], *p = bytes;
    uint16_t words[REPORT_HEAD + 3 * MOST_AXES + 2];
    if (!has_begun) return;
    int word_count = report(words);
    states_sent++;
    p = put(p, "VCLS\2", 5); *p++ = told_count;
    p = put16(p, machine); p = put32(p, run_number); p = put32(p, states_sent);
    p = put16(p, flags); p = put16(p, word_count);
    uint64_t now = now_ns();
    p = put(p, &now, 8); p = put32(p, period); p = put32(p, 0);
    for (int i = 0; i < told_count; i++) {
        int is_corrected = i < axis_count;
        double at = pos_cmd(i), velocity = (at - last_position[i]) * 1e9 / period;
        int64_t offset = is_corrected ? llround(eoffset(i) * NANO) : 0;
        last_position[i] = at;
        p = put32(p, (uint8_t)(is_corrected ? axes[i] : reads[i - axis_count]));
        p = put32(p, is_corrected ? step[i] : 1);
        p = put(p, &at, 8); p = put(p, &velocity, 8); p = put(p, &offset, 8);
    }
    p = put(p, words, 2 * word_count);
    uint64_t code = mac(bytes, p - bytes);
    p = put(p, &code, MAC_BYTES);
    for (int i = 0; i < SENDERS; i++) if (senders[i].is_there) send_to(&senders[i].address, bytes, p - bytes);
    for (int i = 0; i < once_count; i++) send_to(&once[i], bytes, p - bytes);
    once_count = 0;
}
