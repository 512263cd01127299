/* SPDX-License-Identifier: GPL-2.0-or-later */
/* The component of the servo thread without LinuxCNC. Who includes this includes the component, and is under its licence.
   What the test makes of volcomp.comp lies in a folder of its own: pins.h, its pins and includes, and body.c, its program, which is
   included behind this. */
#include "pins.h"

/* Here pins are variables of their own, and the component has none. */
struct __comp_state { int unused; };
static struct __comp_state *__comp_inst;

#define RTAPI_MP_STRING(name, what)
#define RTAPI_MP_INT(name, what)
#define RTAPI_MP_ARRAY_INT(name, count, what)
#define RTAPI_MSG_ERR 1
#define rtapi_print_msg(level, ...) fprintf(stderr, __VA_ARGS__)
#define EXTRA_SETUP() static int setup(struct __comp_state *__comp_inst, const char *prefix, long extra_arg)
#define EXTRA_CLEANUP() static void cleanup(void)
#define FUNCTION(name) static void name(long period)
