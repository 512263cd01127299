# SPDX-License-Identifier: GPL-2.0-or-later
# The HAL part of the bridge without LinuxCNC: arguments are that file and the INI file. It reads the INI file into arrays as
# LinuxCNC's haltcl does, and commands of HAL do nothing. It sources a file of the bridge, and is under their licence.

proc unknown {args} {}

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
