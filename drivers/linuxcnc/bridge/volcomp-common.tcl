# SPDX-License-Identifier: GPL-2.0-or-later
# What the HAL parts of both bridges have in common: what they need of the INI file, and pins that are only read.

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

# A number of a section; without a default it has to be there.
proc number_of {section key default expected} {
    if {![has $section $key]} {
        if {$default eq ""} {
            refuse "\[$section\]$key is missing, expected $expected"
        }
        return $default
    }
    set value [value_of $section $key]
    # Tcl alone takes others: 0x10.
    if {![regexp {^[+-]?([0-9]+[.]?[0-9]*|[.][0-9]+)([eE][+-]?[0-9]+)?$} $value] || abs($value) > 1e9} {
        refuse "\[$section\]$key: found $value, expected $expected and nothing behind it"
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
        refuse "\[KINS\]JOINTS: found $joints, expected $expected and nothing behind it"
    }
    return [expr {int($joints)}]
}

# The period of the servo thread, s.
proc period_s {} {
    set expected "the period of the servo thread in ns"
    set period [number_of EMCMOT SERVO_PERIOD 1000000 $expected]
    if {$period <= 0} {
        refuse "\[EMCMOT\]SERVO_PERIOD: found $period, expected $expected"
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

# A key that is written wrongly would leave its default in force.
proc known_keys {} {
    set known {MACHINE AXES READS PORT LISTEN STEP_NM STEP_UDEG LIMIT_UM LIMIT_MDEG RATE_UM_PER_S RATE_MDEG_PER_S HOLD_MS TIME_OUT_MS EPOCH_FILE}
    foreach key [lsort [array names ::VOLCOMP]] {
        if {$key ni $known} {
            refuse "\[VOLCOMP\]$key: unknown key, expected one of [join $known {, }]"
        }
    }
}

# Loads a component; where it cannot be loaded, ends with the most likely cause.
proc load_component {why args} {
    if {[catch {loadrt {*}$args}]} {
        refuse "loadrt [lindex $args 0] failed: $why"
    }
}

# A pin that the machine's own files have connected keeps its signal.
proc read_pin {signal from to} {
    if {[catch {net $signal $from => $to}]} {
        set owner [lindex [hal show pin $from] end]
        net $owner => $to
    }
}
