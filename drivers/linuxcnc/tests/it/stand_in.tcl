# SPDX-License-Identifier: GPL-2.0-or-later
# The HAL part of the bridge without LinuxCNC: arguments are that file and the INI file. It reads the INI file into arrays as
# LinuxCNC's haltcl does; commands of HAL do nothing, and that which loads the component is printed. It sources a file of the bridge, and is under their licence.

proc unknown {args} {}

proc loadrt {args} {
    puts "loadrt $args"
}

# A pin that an earlier file has connected to the signal `own`; what the bridge's file connects is printed.
if {[info exists ::env(CONNECTED)]} {
    proc net {signal args} {
        if {[lindex $args 0] eq $::env(CONNECTED)} {
            error "already linked"
        }
        puts "net $signal $args"
    }
    proc hal {args} {
        set pin $::env(CONNECTED)
        return "Component Pins:\nOwner Type Dir Value Name\n 24 float OUT 0 $pin ==> own\n 24 float IN 1e-06 $pin-scale\n"
    }
}

lassign $argv file ::env(INI_FILE_NAME)
set of ""
set channel [open $::env(INI_FILE_NAME)]
foreach line [split [read $channel] "\n"] {
    set line [string trim $line]
    set at [string first "=" $line]
    if {[string index $line 0] eq "\["} {
        set of [string trim $line {[]}]
    } elseif {$at > 0 && [string index $line 0] ni {# ;}} {
        lappend ::${of}([string trim [string range $line 0 $at-1]]) [string trim [string range $line $at+1 end]]
    }
}
close $channel
source $file
