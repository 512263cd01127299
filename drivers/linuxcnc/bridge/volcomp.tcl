# SPDX-License-Identifier: GPL-2.0-or-later
# The HAL part of the bridge: loads volcomp.comp with the settings of the section [VOLCOMP], and connects it. It is the last HALFILE:
# it takes the signals that the machine's own files have connected, and a pin that it has connected itself takes no other signal.
# The component is built and installed once: `sudo halcompile --install volcomp.comp`.

# Ends the start of LinuxCNC with one line. Tcl's `error` would add the lines of this file in which it was found.
proc refuse {what} {
    puts stderr "volcomp: $::env(INI_FILE_NAME): $what"
    exit 1
}

# Whether a key is there, and its first value, which is the one that counts.
proc has {section key} {
    return [info exists ::${section}($key)]
}

proc value_of {section key} {
    return [lindex [set ::${section}($key)] 0]
}

proc setting {key default} {
    if {[has VOLCOMP $key]} {
        return [value_of VOLCOMP $key]
    }
    return $default
}

# A text as a number, empty where it is none. Tcl alone takes 0x10 as well, and 010 as 8.
proc decimal {text} {
    if {![regexp {^[+-]?([0-9]+[.]?[0-9]*|[.][0-9]+)([eE][+-]?[0-9]+)?$} $text]} {
        return ""
    }
    return [scan $text %f]
}

# A number of a section; without a default it has to be there.
proc number_of {section key default expected} {
    if {![has $section $key]} {
        if {$default eq ""} {
            refuse "\[$section\]$key is missing, expected $expected"
        }
        return $default
    }
    set value [decimal [value_of $section $key]]
    if {$value eq "" || abs($value) > 1e9} {
        refuse "\[$section\]$key: found [value_of $section $key], expected $expected without further text"
    }
    return $value
}

proc number {key {default ""}} {
    return [number_of VOLCOMP $key $default "a number"]
}

# The letters of axes that a key has, as capitals.
proc letters {key default} {
    set found [split [string toupper [string map {" " ""} [setting $key $default]]] ""]
    foreach letter $found {
        if {$letter ni {X Y Z A B C U V W}} {
            refuse "\[VOLCOMP\]$key: found $letter, expected axes of X Y Z A B C U V W"
        }
    }
    return $found
}

# The axes that are corrected, and those of which only the positions are told.
proc axes_and_reads {} {
    set axes [letters AXES XYZ]
    set reads [letters READS ""]
    set both [concat $axes $reads]
    if {[llength $axes] == 0 || [llength [lsort -unique $both]] != [llength $both]} {
        refuse "\[VOLCOMP\]AXES and READS: found [join $axes ""] and [join $reads ""], expected one or more axes, each once"
    }
    return [list $axes $reads]
}

proc joints {} {
    set expected "the number of joints, 1 to 16"
    set joints [number_of KINS JOINTS "" $expected]
    if {$joints != int($joints) || $joints < 1 || $joints > 16} {
        refuse "\[KINS\]JOINTS: found [value_of KINS JOINTS], expected $expected without further text"
    }
    return [expr {int($joints)}]
}

# The period of the servo thread, s.
proc period_s {} {
    set expected "the period of the servo thread in ns"
    set period [number_of EMCMOT SERVO_PERIOD 1000000 $expected]
    if {$period <= 0} {
        refuse "\[EMCMOT\]SERVO_PERIOD: found [value_of EMCMOT SERVO_PERIOD], expected $expected"
    }
    return [expr {$period * 1e-9}]
}

# An offset is in the unit of the machine, and a count is one of these: a machine in inches would get 25.4 times as much. The words
# are those that LinuxCNC takes for mm and degrees, in any case; it takes numbers, too, and what stands behind a number: those are refused.
proc units {} {
    foreach {key known} {LINEAR_UNITS {mm metric} ANGULAR_UNITS {degree deg}} {
        set expected [join $known " or "]
        if {![has TRAJ $key]} {
            refuse "\[TRAJ\]$key is missing, expected $expected: the bridge counts in this unit"
        }
        set found [value_of TRAJ $key]
        if {[string tolower $found] ni $known} {
            refuse "\[TRAJ\]$key: found $found, expected $expected: the bridge counts in this unit, and no other is supported. Do not change this key alone: all lengths or angles of the INI file are in it"
        }
    }
}

# In coordinated mode LinuxCNC takes an axis with an offset that stands beyond its soft limit back to it in one cycle. In joint mode only the
# limits of the joint keep it from there.
proc joint_limits {letters} {
    set coordinates XYZABCUVW
    if {[has KINS KINEMATICS]} {
        regexp {coordinates=([A-Za-z]+)} [value_of KINS KINEMATICS] all coordinates
    }
    set joint 0
    foreach letter [split [string toupper $coordinates] ""] {
        foreach {key word compare} {MIN_LIMIT least >= MAX_LIMIT most <=} {
            if {$letter in $letters && [has AXIS_$letter $key]} {
                set limit [value_of AXIS_$letter $key]
                set found none
                if {[has JOINT_$joint $key]} {
                    set found [value_of JOINT_$joint $key]
                }
                set numbers [list [decimal $found] [decimal $limit]]
                if {"" in $numbers || ![expr [join $numbers " $compare "]]} {
                    refuse "\[JOINT_$joint\]$key: found $found, expected at $word $limit, \[AXIS_$letter\]$key: where a joint stands beyond it, LinuxCNC takes an axis with an offset back in one cycle"
                }
            }
        }
        incr joint
    }
}

# A key that is written wrongly would leave its default active.
proc known_keys {} {
    set known {MACHINE AXES READS PORT LISTEN STEP_NM STEP_UDEG LIMIT_UM LIMIT_MDEG RATE_UM_PER_S RATE_MDEG_PER_S HOLD_MS TIME_OUT_MS EPOCH_FILE KEY_FILE}
    foreach key [lsort [array names ::VOLCOMP]] {
        if {$key ni $known} {
            refuse "\[VOLCOMP\]$key: unknown key, expected one of [join $known {, }]"
        }
    }
}

# A pin that the machine's own files have connected keeps its signal.
proc read_pin {signal from to} {
    if {[catch {net $signal $from => $to}]} {
        # Other pins are shown as well, whose names begin so: axis.x.eoffset-scale.
        if {![regexp "\\s$from\\s+\\S+\\s+(\\S+)" [hal show pin $from] all owner]} {
            refuse "the pin $from is missing, expected LinuxCNC 2.9"
        }
        net $owner => $to
    }
}

proc whole {key {default ""}} {
    set value [number_of VOLCOMP $key $default "a whole number"]
    if {$value != floor($value)} {
        refuse "\[VOLCOMP\]$key: found [value_of VOLCOMP $key], expected a whole number without further text"
    }
    return [expr {int($value)}]
}

known_keys
units
lassign [axes_and_reads] letters reads
set joints [joints]
joint_limits $letters
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
        refuse "\[VOLCOMP\]$key: found [value_of VOLCOMP $key], expected more than 0"
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
lappend arguments key_file=[file join $folder [setting KEY_FILE volcomp.key]]
lappend arguments step=[join $steps ,] limit=[join $limits ,] rate=[join $rates ,] step_scans=$step_scans
lappend arguments hold_scans=[expr {int(round([number HOLD_MS 100] * 1e-3 / $period_s))}]
lappend arguments time_out_scans=[expr {int(round([number TIME_OUT_MS 300] * 1e-3 / $period_s))}]
if {[llength $reads]} {
    lappend arguments reads=[join $reads ""]
}
if {[catch {loadrt volcomp {*}$arguments}]} {
    refuse "loadrt volcomp failed: build and install it (sudo halcompile --install volcomp.comp), or correct what the lines above this one name"
}

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
