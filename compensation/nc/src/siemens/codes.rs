//! What the G codes and the names of SINUMERIK mean: from memory of its programming manual, unproven on a control.

use crate::{
    command::Command,
    modal::{G500, G505},
};

/// What a G code or a name does.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Meaning {
    /// What RS-274 has this code for.
    Code(f64),
    Command(Command),
    /// It moves nothing.
    Nothing,
    /// A dwell: its F and S are times.
    Dwell,
    /// Limits: its coordinates move nothing.
    Limits,
    /// It is not followed.
    Refused(&'static str),
}

/// The reason why what is not known is refused.
pub(super) const UNKNOWN: &str = "it is not known here, and might move an axis";
const FLOW: &str = "which lines are executed after it, is not followed in this language";
const CALL: &str = "subprograms are not followed in this language";
const ORIENTATION: &str = "orientations of the tool are followed as angles of the rotary axes only";
const TILTED: &str = "frames other than TRANS, ATRANS, ROT and AROT about Z are not followed";
const CORNER: &str = "a rounded or bevelled corner is a motion of its own";
const CURVE: &str = "a curve other than a line or an arc by its centre or radius";
const POLAR: &str = "polar coordinates";
const PLACE: &str = "it leads to a place that only the control knows";
const OWN_RULE: &str = "it moves axes by a rule of its own";
const APPROACH: &str = "soft approach and retraction make motions of their own";
const TRANSFORMATION: &str = "no transformation other than TRAORI is followed";

/// What a G code means, and the group of which one may stand in a block.
pub(super) fn g_code(code: u32) -> (u8, Meaning) {
    match code {
        0..=3 => (1, Meaning::Code(f64::from(code))),
        33..=35 | 63 | 331 | 332 => (1, Meaning::Refused(OWN_RULE)),
        4 => (2, Meaning::Dwell),
        74 | 75 => (2, Meaning::Refused(PLACE)),
        147 | 148 | 247 | 248 | 347 | 348 => (2, Meaning::Refused(APPROACH)),
        25 | 26 => (3, Meaning::Limits),
        58 | 59 => (3, Meaning::Refused(TILTED)),
        110..=112 => (3, Meaning::Refused(POLAR)),
        17..=19 => (6, Meaning::Code(f64::from(code))),
        40..=42 => (7, Meaning::Code(f64::from(code))),
        500 => (8, Meaning::Command(Command::WorkOffset(G500))),
        54..=57 => {
            let system = [0, 1, 2, 3][code as usize - 54];
            (8, Meaning::Command(Command::WorkOffset(system)))
        }
        505..=599 => {
            let system = G505 + (code as usize - 505);
            (8, Meaning::Command(Command::WorkOffset(system)))
        }
        53 | 153 => (9, Meaning::Command(Command::InMachine)),
        70 | 700 => (13, Meaning::Code(20.0)),
        71 | 710 => (13, Meaning::Code(21.0)),
        90 | 91 => (14, Meaning::Code(f64::from(code))),
        93..=95 => (15, Meaning::Code(f64::from(code))),
        // Surface speeds, exact stops, path control, the manner of approach and of corners.
        96 | 97 | 961 | 962 | 971..=973 => (15, Meaning::Nothing),
        9 => (11, Meaning::Nothing),
        60 | 64 | 641..=645 => (10, Meaning::Nothing),
        601..=603 => (12, Meaning::Nothing),
        62 | 621 => (57, Meaning::Nothing),
        140..=143 => (43, Meaning::Nothing),
        340 | 341 => (44, Meaning::Nothing),
        450 | 451 => (18, Meaning::Nothing),
        460..=462 => (48, Meaning::Nothing),
        290 => (47, Meaning::Nothing),
        _ => (0, Meaning::Refused(UNKNOWN)),
    }
}

/// Names that move nothing, alone, with a value, or with arguments.
const HARMLESS: [&str; 90] = [
    "ACC",
    "ADIS",
    "ADISPOS",
    "ATOL",
    "BRISK",
    "BRISKA",
    "CDOF",
    "CDOF2",
    "CDON",
    "CFC",
    "CFIN",
    "CFTCP",
    "CLEARM",
    "COMPCAD",
    "COMPCURV",
    "COMPOF",
    "COMPON",
    "COMPSURF",
    "CP",
    "CTOL",
    "CUT2D",
    "CUT2DD",
    "CUT2DF",
    "CUT2DFD",
    "CUT3DC",
    "CUT3DCC",
    "CUT3DF",
    "CUT3DFF",
    "CUT3DFS",
    "CUTCONOF",
    "CYCLE832",
    "DIAMOF",
    "DISC",
    "DISPLOF",
    "DISPLON",
    "DRIVE",
    "DRIVEA",
    "DYNFINISH",
    "DYNNORM",
    "DYNPOS",
    "DYNROUGH",
    "DYNSEMIFIN",
    "FA",
    "FB",
    "FCUB",
    "FD",
    "FFWOF",
    "FFWON",
    "FGREF",
    "FGROUP",
    "FIFOCTRL",
    "FL",
    "FLIN",
    "FNORM",
    "FZ",
    "GROUP_BEGIN",
    "GROUP_END",
    "JERKLIM",
    "KONT",
    "KONTC",
    "KONTT",
    "LIMS",
    "MSG",
    "NORM",
    "ORIAXES",
    "ORIMKS",
    "OTOL",
    "OVR",
    "OVRRAP",
    "RTLIOF",
    "RTLION",
    "SAVE",
    "SBLOF",
    "SBLON",
    "SETM",
    "SETMS",
    "SOFT",
    "SOFTA",
    "SPATH",
    "SPCOF",
    "SPCON",
    "SPOS",
    "SPOSA",
    "STARTFIFO",
    "STOPFIFO",
    "STOPRE",
    "UPATH",
    "WAITM",
    "WAITS",
    "WORKPIECE",
];

/// What a name means.
pub(super) fn name(name: &str) -> Meaning {
    if HARMLESS.binary_search(&name).is_ok() {
        return Meaning::Nothing;
    }
    match name {
        "TRANS" => Meaning::Command(Command::Shift { adds: false }),
        "ATRANS" => Meaning::Command(Command::Shift { adds: true }),
        "SUPA" => Meaning::Command(Command::InMachine),
        "TRAFOOF" => Meaning::Command(Command::CentrePoint(false)),
        "RET" => Meaning::Command(Command::Ends),
        "IF" | "ELSE" | "ENDIF" | "GOTO" | "GOTOF" | "GOTOB" | "GOTOC" | "GOTOS" | "CASE"
        | "WHILE" | "ENDWHILE" | "FOR" | "ENDFOR" | "LOOP" | "ENDLOOP" | "REPEAT" | "REPEATB"
        | "UNTIL" | "WHEN" | "WHENEVER" | "EVERY" | "DO" | "ID" | "IDS" | "FROM" => {
            Meaning::Refused(FLOW)
        }
        "CALL" | "PCALL" | "EXTCALL" | "ISOCALL" | "MODAL" => Meaning::Refused(CALL),
        "SCALE" | "ASCALE" | "MIRROR" | "AMIRROR" | "ROTS" | "AROTS" | "CROTS" | "TOFRAME"
        | "TOFRAMEX" | "TOFRAMEY" | "TOFRAMEZ" | "TOROT" | "TOROTX" | "TOROTY" | "TOROTZ"
        | "PAROT" | "CYCLE800" | "TCARR" | "TCOABS" | "TCOFR" | "CTRANS" | "CROT" | "CFINE" => {
            Meaning::Refused(TILTED)
        }
        "RND" | "RNDM" | "CHF" | "CHR" | "FRC" | "FRCM" => Meaning::Refused(CORNER),
        "CIP" | "CT" | "TURN" | "ASPLINE" | "BSPLINE" | "CSPLINE" | "POLY" | "INVCW" | "INVCCW"
        | "ANG" | "ANG1" | "ANG2" | "PW" | "SD" | "PO" | "PL" => Meaning::Refused(CURVE),
        "AP" | "RP" => Meaning::Refused(POLAR),
        "LEAD" | "TILT" | "THETA" | "PHI" | "PSI" | "NUT" => Meaning::Refused(ORIENTATION),
        "TRANSMIT" | "TRACYL" | "TRAANG" | "TRACON" | "TRACOORD" => {
            Meaning::Refused(TRANSFORMATION)
        }
        "POS" | "POSA" | "POSP" | "POSM" | "MEAS" | "MEAW" | "MEASA" | "MEAWA" | "PTP"
        | "PTPG0" | "DIAMON" | "DIAM90" | "DL" | "TOFFL" | "TOFF" | "OSCILL" | "COUPON"
        | "TRAILON" | "LEADON" | "STARTFIX" => Meaning::Refused(OWN_RULE),
        _ if name.starts_with("ORI") => Meaning::Refused(ORIENTATION),
        _ => Meaning::Refused(UNKNOWN),
    }
}

/// Whether a call with this name is a cycle that moves along the tool only, and ends at its first argument; `None`: it is no cycle.
pub(super) fn only_drills(name: &str) -> Option<bool> {
    const OTHERS: [&str; 18] = [
        "CYCLE60", "CYCLE61", "CYCLE62", "CYCLE63", "CYCLE64", "CYCLE70", "CYCLE71", "CYCLE72",
        "CYCLE76", "CYCLE77", "CYCLE78", "CYCLE79", "CYCLE90", "CYCLE801", "CYCLE802", "CYCLE899",
        "HOLES1", "HOLES2",
    ];
    let is_drilling = matches!(
        name,
        "CYCLE81"
            | "CYCLE82"
            | "CYCLE83"
            | "CYCLE84"
            | "CYCLE85"
            | "CYCLE86"
            | "CYCLE87"
            | "CYCLE88"
            | "CYCLE89"
            | "CYCLE840"
    );
    let is_other = OTHERS.contains(&name)
        || ["POCKET", "SLOT", "LONGHOLE"].iter().any(|family| {
            let number = name.strip_prefix(family);
            number.is_some_and(|number| number.bytes().all(|byte| byte.is_ascii_digit()))
        });
    (is_drilling || is_other).then_some(is_drilling)
}

#[cfg(test)]
mod tests {
    use super::HARMLESS;

    #[test]
    fn names_are_sorted() {
        assert!(HARMLESS.is_sorted());
    }
}
