# SPDX-License-Identifier: GPL-2.0-or-later
# The HAL part of the bridge in the servo thread: a HALFILE of its own, in place of volcomp.tcl, after the one that loads the
# motion controller. Built and installed once by `halcompile --install volcomp.comp`.

proc setting {key {default ""}} {
    if {[info exists ::VOLCOMP($key)]} {
        return [lindex $::VOLCOMP($key) 0]
    }
    if {$default eq ""} {
        error "\[VOLCOMP\]$key is missing"
    }
    return $default
}

set letters [split [string toupper [string map {" " ""} [setting AXES XYZ]]] ""]
set reads {}
if {[info exists ::VOLCOMP(READS)]} {
    set reads [split [string toupper [string map {" " ""} [lindex $::VOLCOMP(READS) 0]]] ""]
}
set joints $::KINS(JOINTS)
set period_s [expr {[info exists ::EMCMOT(SERVO_PERIOD)] ? $::EMCMOT(SERVO_PERIOD) * 1e-9 : 1e-3}]
set folder [file dirname [file normalize $::env(INI_FILE_NAME)]]
set arguments [list axes=[join $letters ""] machine=[setting MACHINE] port=[setting PORT 47001] \
    listen_on=[setting LISTEN 127.0.0.1] joints=$joints epoch_file=$folder/[setting EPOCH_FILE volcomp.epoch]]
if {[llength $reads]} {
    lappend arguments reads=[join $reads ""]
}
eval loadrt volcomp $arguments

# The largest rate, and the smallest number of cycles from step to step with which it is a count or more.
set step_scans 1
set at 0
foreach letter $letters {
    set turns [expr {$letter in {A B C}}]
    set step($at) [expr {int($turns ? [setting STEP_UDEG 1] : [setting STEP_NM 1])}]
    set limit($at) [expr {int(1000.0 * [setting [expr {$turns ? "LIMIT_MDEG" : "LIMIT_UM"}]] / $step($at))}]
    set rate($at) [expr {1000.0 * [setting [expr {$turns ? "RATE_MDEG_PER_S" : "RATE_UM_PER_S"}]] * $period_s / $step($at)}]
    set step_scans [expr {max($step_scans, int(ceil(1.0 / $rate($at) - 1e-9)))}]
    incr at
}
setp volcomp.step-scans $step_scans
setp volcomp.hold-scans [expr {round([setting HOLD_MS 100] * 1e-3 / $period_s)}]
setp volcomp.time-out-scans [expr {round([setting TIME_OUT_MS 300] * 1e-3 / $period_s)}]

addf volcomp.take servo-thread 1
addf volcomp.tell servo-thread

set at 0
foreach letter [concat $letters $reads] {
    set small [string tolower $letter]
    net volcomp-cmd-$small axis.$small.pos-cmd => volcomp.pos-cmd-$at
    if {$at < [llength $letters]} {
        setp volcomp.step-$at $step($at)
        setp volcomp.limit-$at $limit($at)
        setp volcomp.rate-$at [expr {int($rate($at) * $step_scans + 1e-9)}]
        net volcomp-eoffset-$small axis.$small.eoffset => volcomp.eoffset-$at
        net volcomp-request-$small axis.$small.eoffset-request => volcomp.request-$at
        net volcomp-counts-$small volcomp.counts-$at => axis.$small.eoffset-counts
        net volcomp-enable volcomp.enable => axis.$small.eoffset-enable
        setp axis.$small.eoffset-scale 1e-6
    }
    incr at
}
# A pin that the machine's own files have connected keeps its signal.
proc read_pin {signal from to} {
    if {[catch {net $signal $from => $to}]} {
        set owner [lindex [hal show pin $from] end]
        net $owner => $to
    }
}
read_pin volcomp-enabled motion.motion-enabled volcomp.enabled
read_pin volcomp-estop iocontrol.0.emc-enable-in volcomp.estop-ok
read_pin volcomp-user iocontrol.0.user-enable-out volcomp.user-ok
read_pin volcomp-limited motion.eoffset-limited volcomp.limited
read_pin volcomp-type motion.motion-type volcomp.motion-type
read_pin volcomp-probe motion.probe-input volcomp.probe-input
for {set joint 0} {$joint < $joints} {incr joint} {
    read_pin volcomp-homed-$joint joint.$joint.homed volcomp.homed-$joint
}
