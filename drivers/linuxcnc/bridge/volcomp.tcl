# SPDX-License-Identifier: GPL-2.0-or-later
# The HAL part of the bridge in user space, for any axes: a HALFILE of its own, after the one that loads the motion controller.
#
#   [HAL]
#   HALFILE = machine.hal
#   HALFILE = PATH/volcomp.tcl
#
# The bridge may die; the last counts that it wrote must not stay for ever. So they go through a factor, the same for all
# axes, that falls from 1 to 0 in the servo thread when the bridge has not been alive for 0.2 s.

set here [file dirname [file normalize [info script]]]
set letters [string tolower [string map {" " ""} $::VOLCOMP(AXES)]]
set thread servo-thread
set multiply {}
set convert {}
foreach letter [split $letters ""] {
    lappend multiply volcomp.scaled-$letter
    lappend convert volcomp.whole-$letter
}

# How fast the factor may change, 1/s: no axis goes faster than its rate from its limit.
set fastest 5.0
foreach {limit rate} {LIMIT_UM RATE_UM_PER_S LIMIT_MDEG RATE_MDEG_PER_S} {
    if {[info exists ::VOLCOMP($limit)] && [info exists ::VOLCOMP($rate)]} {
        set fastest [expr {min($fastest, double([lindex $::VOLCOMP($rate) 0]) / [lindex $::VOLCOMP($limit) 0])}]
    }
}

loadrt sum2 names=volcomp.begin,volcomp.end
loadrt oneshot names=volcomp.heard
loadrt mux2 names=volcomp.chosen
loadrt limit2 names=volcomp.ramp
loadrt mult2 names=[join $multiply ,]
loadrt conv_float_s32 names=[join $convert ,]

# Cycles of the servo thread, counted at its begin and at its end: what is read between two equal numbers is of one cycle.
addf volcomp.begin $thread 1
setp volcomp.begin.in1 1
net volcomp-begin volcomp.begin.out => volcomp.begin.in0

addf volcomp.heard $thread
addf volcomp.chosen $thread
addf volcomp.ramp $thread
foreach name [concat $multiply $convert] {
    addf $name $thread
}
addf volcomp.end $thread
setp volcomp.end.in1 1
net volcomp-end volcomp.end.out => volcomp.end.in0

setp volcomp.heard.width 0.2
setp volcomp.heard.rising 1
setp volcomp.heard.falling 1
setp volcomp.heard.retriggerable 1
net volcomp-alive => volcomp.heard.in
net volcomp-heard volcomp.heard.out => volcomp.chosen.sel
setp volcomp.chosen.in0 0
setp volcomp.chosen.in1 1
net volcomp-chosen volcomp.chosen.out => volcomp.ramp.in
setp volcomp.ramp.maxv $fastest
net volcomp-factor volcomp.ramp.out

newsig volcomp-enable bit
foreach letter [split $letters ""] {
    net volcomp-factor => volcomp.scaled-$letter.in1
    net volcomp-counts-$letter => volcomp.scaled-$letter.in0
    net volcomp-scaled-$letter volcomp.scaled-$letter.out => volcomp.whole-$letter.in
    net volcomp-whole-$letter volcomp.whole-$letter.out => axis.$letter.eoffset-counts
    net volcomp-enable => axis.$letter.eoffset-enable
    setp axis.$letter.eoffset-scale 1e-6
}

loadusr -Wn volcomp $here/volcomp_bridge.py $::env(INI_FILE_NAME)
