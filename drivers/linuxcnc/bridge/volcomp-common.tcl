# SPDX-License-Identifier: GPL-2.0-or-later
# What the HAL parts of both bridges have in common: the section [VOLCOMP] of the INI file, and pins that are only read.

proc setting {key {default ""}} {
    if {[info exists ::VOLCOMP($key)]} {
        return [lindex $::VOLCOMP($key) 0]
    }
    if {$default eq ""} {
        error "\[VOLCOMP\]$key is missing"
    }
    return $default
}

proc number {key {default ""}} {
    set value [setting $key $default]
    if {![string is double -strict $value] || $value != $value || abs($value) > 1e9} {
        error "\[VOLCOMP\]$key: found $value, expected a number and nothing behind it"
    }
    return $value
}

# The letters of axes that a key has, as capitals.
proc letters {key default} {
    set value $default
    if {[info exists ::VOLCOMP($key)]} {
        set value [lindex $::VOLCOMP($key) 0]
    }
    set found [split [string toupper [string map {" " ""} $value]] ""]
    foreach letter $found {
        if {$letter ni {X Y Z A B C U V W}} {
            error "\[VOLCOMP\]$key: found $letter, expected axes of X Y Z A B C U V W"
        }
    }
    return $found
}

# A pin that the machine's own files have connected keeps its signal.
proc read_pin {signal from to} {
    if {[catch {net $signal $from => $to}]} {
        set owner [lindex [hal show pin $from] end]
        net $owner => $to
    }
}
