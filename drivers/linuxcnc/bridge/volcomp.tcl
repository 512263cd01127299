# SPDX-License-Identifier: GPL-2.0-or-later
# The HAL part of the bridge in user space, for any axes: a HALFILE of its own, after the one that loads the motion controller.
#
#   [HAL]
#   HALFILE = machine.hal
#   HALFILE = PATH/volcomp.tcl
#
# The bridge may die; the last counts that it wrote must not stay for ever. So what LinuxCNC shows as requested by them is taken
# out of them by the servo thread when the bridge has not been alive for 0.2 s: by one factor for all axes, that falls from 1 to 0.
# LinuxCNC goes by changes of the counts, so that their zero is anywhere once it has lost an offset: that zero, the origin, is
# worked out here, in every cycle while the factor is 1 and nothing depends on it, and outlives the bridge.
#
#   counts to LinuxCNC = (counts of the bridge - origin) * factor + origin
#
# The factor does not rise by itself when the bridge is heard again: only when the bridge says so, after it has asked for nothing.

set here [file dirname [file normalize [info script]]]
source [file join $here volcomp-common.tcl]

if {[has HAL TWOPASS]} {
    refuse "\[HAL\]TWOPASS: found [value_of HAL TWOPASS], expected none with volcomp.tcl, which starts a program that needs what is loaded; leave it out, or use volcomp-servo.tcl"
}
# All of these are told before anything is loaded; the bridge judges them by the same rules.
known_keys
units
joints
period_s
set letters [string tolower [lindex [axes_and_reads] 0]]
set thread servo-thread

# How fast the factor may change, 1/s: no axis goes faster than its rate from its limit.
set fastest 5.0
foreach {limit rate} {LIMIT_UM RATE_UM_PER_S LIMIT_MDEG RATE_MDEG_PER_S} {
    if {[info exists ::VOLCOMP($limit)] && [info exists ::VOLCOMP($rate)]} {
        set fastest [expr {min($fastest, double([number $rate]) / [number $limit])}]
    }
}

proc of_axes {what} {
    return [lmap letter $::letters {string cat volcomp. $what - $letter}]
}
set sums {}
foreach what {origin way asked rounded} {
    lappend sums {*}[of_axes $what]
}
set once "LinuxCNC loads each component once. Where the machine's own HAL files load it, take volcomp-servo.tcl, which does not need it"
load_component $once sum2 names=[join [concat volcomp.begin volcomp.end $sums] ,]
load_component $once oneshot names=volcomp.heard
load_component $once flipflop names=volcomp.trusted
load_component $once mux2 names=[join [concat volcomp.chosen [of_axes kept]] ,]
load_component $once limit2 names=volcomp.ramp
load_component $once comp names=volcomp.full
load_component $once mult2 names=[join [of_axes scaled] ,]
load_component $once limit1 names=[join [of_axes half] ,]
load_component $once conv_float_s32 names=[join [of_axes whole] ,]

# Cycles of the servo thread, counted at its begin and at its end: what is read between two equal numbers is of one cycle.
addf volcomp.begin $thread 1
setp volcomp.begin.in1 1
net volcomp-begin volcomp.begin.out => volcomp.begin.in0

foreach name {volcomp.heard volcomp.trusted volcomp.chosen volcomp.ramp volcomp.full} {
    addf $name $thread
}
foreach what {origin kept way scaled asked half rounded whole} {
    foreach name [of_axes $what] {
        addf $name $thread
    }
}
addf volcomp.end $thread
setp volcomp.end.in1 1
net volcomp-end volcomp.end.out => volcomp.end.in0

setp volcomp.heard.width 0.2
setp volcomp.heard.rising 1
setp volcomp.heard.falling 1
setp volcomp.heard.retriggerable 1
net volcomp-alive => volcomp.heard.in
net volcomp-silent volcomp.heard.out-not => volcomp.trusted.reset
setp volcomp.trusted.data 1
net volcomp-trust => volcomp.trusted.clk
net volcomp-trusted volcomp.trusted.out => volcomp.chosen.sel
setp volcomp.chosen.in0 0
setp volcomp.chosen.in1 1
net volcomp-chosen volcomp.chosen.out => volcomp.ramp.in
setp volcomp.ramp.maxv $fastest
net volcomp-factor volcomp.ramp.out => volcomp.full.in1
setp volcomp.full.in0 0.999999999
net volcomp-full volcomp.full.out

newsig volcomp-enable bit
foreach letter $letters {
    net volcomp-counts-$letter => volcomp.origin-$letter.in0 volcomp.way-$letter.in0
    # Where the counts would be with nothing asked for: kept from the moment when the factor begins to fall.
    setp volcomp.origin-$letter.gain1 -1e6
    read_pin volcomp-request-$letter axis.$letter.eoffset-request volcomp.origin-$letter.in1
    net volcomp-zero-$letter volcomp.origin-$letter.out => volcomp.kept-$letter.in1
    net volcomp-full => volcomp.kept-$letter.sel
    net volcomp-origin-$letter volcomp.kept-$letter.out => volcomp.kept-$letter.in0
    setp volcomp.way-$letter.gain1 -1
    net volcomp-origin-$letter => volcomp.way-$letter.in1 volcomp.asked-$letter.in1
    net volcomp-way-$letter volcomp.way-$letter.out => volcomp.scaled-$letter.in0
    net volcomp-factor => volcomp.scaled-$letter.in1
    net volcomp-scaled-$letter volcomp.scaled-$letter.out => volcomp.asked-$letter.in0
    # The conversion cuts towards zero: with half a count more on the same side it rounds.
    setp volcomp.half-$letter.min -0.5
    setp volcomp.half-$letter.max 0.5
    net volcomp-asked-$letter volcomp.asked-$letter.out => volcomp.half-$letter.in volcomp.rounded-$letter.in0
    net volcomp-half-$letter volcomp.half-$letter.out => volcomp.rounded-$letter.in1
    net volcomp-rounded-$letter volcomp.rounded-$letter.out => volcomp.whole-$letter.in
    net volcomp-whole-$letter volcomp.whole-$letter.out => axis.$letter.eoffset-counts
    net volcomp-enable => axis.$letter.eoffset-enable
    setp axis.$letter.eoffset-scale 1e-6
    # The offset at the last contact of a probe, under one name for every bridge that is started.
    newsig volcomp-probed-offset-$letter float
}

loadusr -Wn volcomp $here/volcomp_bridge.py $::env(INI_FILE_NAME)
