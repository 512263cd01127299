# SPDX-License-Identifier: GPL-2.0-or-later
# The HAL part of the bridge in the servo thread: a HALFILE of its own, in place of volcomp.tcl, the last one: it takes the
# signals that the machine's own files have connected, and a pin that it has connected itself takes no other signal any more.
# Built and installed once by `halcompile --install volcomp.comp`.

# No line of this file may end in a backslash: with TWOPASS LinuxCNC would run a copy of it elsewhere, where the other is not.
source [file join [file dirname [file normalize [info script]]] volcomp-common.tcl]

proc whole {key {default ""}} {
    set value [number_of VOLCOMP $key $default "a whole number"]
    if {$value != floor($value)} {
        refuse "\[VOLCOMP\]$key: found $value, expected a whole number and nothing behind it"
    }
    return [expr {int($value)}]
}

known_keys
units
lassign [axes_and_reads] letters reads
set joints [joints]
set period_s [period_s]
set folder [file dirname [file normalize $::env(INI_FILE_NAME)]]

# The largest rate, and the smallest number of cycles from step to step with which it is a count or more. What a word cannot
# hold is refused by the component.
set step_scans 1
set steps {}
set limits {}
set per_scan {}
foreach letter $letters {
    set turns [expr {$letter in {A B C}}]
    set step [expr {$turns ? [whole STEP_UDEG 1] : [whole STEP_NM 1]}]
    set limit [number [expr {$turns ? "LIMIT_MDEG" : "LIMIT_UM"}]]
    set key [expr {$turns ? "RATE_MDEG_PER_S" : "RATE_UM_PER_S"}]
    set rate [number $key]
    if {$step < 1} {
        refuse "\[VOLCOMP\]STEP_NM or STEP_UDEG: found $step, expected 1 or more"
    }
    if {$rate <= 0} {
        refuse "\[VOLCOMP\]$key: found $rate, expected more than 0"
    }
    set rate [expr {1000.0 * $rate * $period_s / $step}]
    lappend steps $step
    lappend limits [expr {int(1000.0 * $limit / $step + 1e-6)}]
    lappend per_scan $rate
    set step_scans [expr {max($step_scans, int(min(ceil(1.0 / $rate - 1e-9), 1e9)))}]
}
set rates {}
foreach rate $per_scan {
    lappend rates [expr {int($rate * $step_scans + 1e-9)}]
}

set port [whole PORT 47001]
if {$port < 0 || $port > 65535} {
    refuse "\[VOLCOMP\]PORT: found $port, expected 0 to 65535"
}
set arguments [list axes=[join $letters ""] machine=[whole MACHINE] port=$port]
lappend arguments listen_on=[setting LISTEN 127.0.0.1] joints=$joints
lappend arguments epoch_file=[file join $folder [setting EPOCH_FILE volcomp.epoch]]
lappend arguments step=[join $steps ,] limit=[join $limits ,] rate=[join $rates ,] step_scans=$step_scans
lappend arguments hold_scans=[expr {int(round([number HOLD_MS 100] * 1e-3 / $period_s))}]
lappend arguments time_out_scans=[expr {int(round([number TIME_OUT_MS 300] * 1e-3 / $period_s))}]
if {[llength $reads]} {
    lappend arguments reads=[join $reads ""]
}
load_component "is it built and installed (sudo halcompile --install volcomp.comp), and do the values of \[VOLCOMP\] fit? Lines above this one say more" volcomp {*}$arguments

addf volcomp.take servo-thread 1
addf volcomp.tell servo-thread

set at 0
foreach letter [concat $letters $reads] {
    set small [string tolower $letter]
    read_pin volcomp-cmd-$small axis.$small.pos-cmd volcomp.pos-cmd-$at
    if {$at < [llength $letters]} {
        read_pin volcomp-eoffset-$small axis.$small.eoffset volcomp.eoffset-$at
        read_pin volcomp-request-$small axis.$small.eoffset-request volcomp.request-$at
        net volcomp-counts-$small volcomp.counts-$at => axis.$small.eoffset-counts
        net volcomp-enable volcomp.enable => axis.$small.eoffset-enable
        setp axis.$small.eoffset-scale 1e-6
        # Under the same name with both bridges.
        net volcomp-probed-offset-$small volcomp.probed-offset-$at
    }
    incr at
}
read_pin volcomp-enabled motion.motion-enabled volcomp.enabled
read_pin volcomp-estop iocontrol.0.emc-enable-in volcomp.estop-ok
read_pin volcomp-user iocontrol.0.user-enable-out volcomp.user-ok
read_pin volcomp-limited motion.eoffset-limited volcomp.limited
read_pin volcomp-coord-mode motion.coord-mode volcomp.coord-mode
read_pin volcomp-teleop-mode motion.teleop-mode volcomp.teleop-mode
read_pin volcomp-type motion.motion-type volcomp.motion-type
read_pin volcomp-probe motion.probe-input volcomp.probe-input
for {set joint 0} {$joint < $joints} {incr joint} {
    read_pin volcomp-homed-$joint joint.$joint.homed volcomp.homed-$joint
}
