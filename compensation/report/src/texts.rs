//! One table of all words of a report, in English and German. Warnings and notes come from the programs in English.

use std::str::FromStr;

use serde::{Deserialize, Serialize};
use volcomp_metrology::MotionKind;
use volcomp_vocabulary::{AxisKind, ErrorName};

/// The language of heads and labels.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Language {
    /// English.
    #[default]
    En,
    /// German.
    De,
}

impl FromStr for Language {
    type Err = &'static str;

    fn from_str(name: &str) -> Result<Self, Self::Err> {
        match name {
            "en" => Ok(Self::En),
            "de" => Ok(Self::De),
            _ => Err("expected en or de"),
        }
    }
}

macro_rules! table {
    ($($name:ident: $en:literal, $de:literal;)*) => {
        /// The words of one language.
        pub(crate) struct Texts {
            pub(crate) language: Language,
            $(pub(crate) $name: &'static str,)*
        }

        const ENGLISH: Texts = Texts { language: Language::En, $($name: $en,)* };
        const GERMAN: Texts = Texts { language: Language::De, $($name: $de,)* };
    };
}

table! {
    code: "en", "de";
    title: "Calibration report", "Kalibrierbericht";
    contents: "Contents", "Inhalt";
    machine: "Machine", "Maschine";
    serial: "Serial number", "Seriennummer";
    date: "Date of measurement", "Datum der Messung";
    operator: "Operator", "Prüfer";
    instrument: "Instrument", "Messgerät";
    air: "Air temperature", "Lufttemperatur";
    material: "Material temperature", "Materialtemperatur";
    structure: "Structure", "Struktur";
    axes: "Axes and travels", "Achsen und Verfahrwege";
    tool: "Tool tip", "Werkzeugspitze";
    source: "Made from", "Erstellt aus";
    not_stated: "not stated", "nicht angegeben";
    files: "Measurement files", "Messdateien";
    file: "file", "Datei";
    measures: "measures", "misst";
    targets: "targets", "Zielpunkte";
    rows: "rows", "Zeilen";
    runs: "runs", "Läufe";
    target: "target", "Zielpunkt";
    verdict: "Verdict", "Ergebnis";
    pass: "pass", "bestanden";
    fail: "fail", "nicht bestanden";
    not_evaluated: "not evaluated", "nicht auswertbar";
    undecided: "undecided", "offen";
    some_undecided: "Not every stated tolerance is decided: a figure is nearer to its limit than its uncertainty.",
        "Nicht jede angegebene Toleranz ist entschieden: Ein Wert liegt näher an seiner Grenze als seine Unsicherheit.";
    all_pass: "All stated tolerances are met.", "Alle angegebenen Toleranzen sind eingehalten.";
    some_fail: "Not all stated tolerances are met.", "Nicht alle angegebenen Toleranzen sind eingehalten.";
    some_missing: "Not every stated tolerance could be evaluated.", "Nicht jede angegebene Toleranz war auswertbar.";
    no_tolerance: "No tolerance stated.", "Keine Toleranz angegeben.";
    no_tolerance_more: "This report gives figures; it does not say whether they are good enough.",
        "Dieser Bericht nennt Werte; er sagt nicht, ob sie genügen.";
    rule: "Where an uncertainty U (k = 2) is stated, by ISO 14253-1: a figure passes where it and U on top are at most the tolerance, fails where it less U is beyond, and is undecided between. Where none is stated the figure alone is compared. U has in it what is stated, and nothing else.",
        "Wo eine Unsicherheit U (k = 2) angegeben ist, nach ISO 14253-1: Ein Wert besteht, wenn er zuzüglich U höchstens gleich der Toleranz ist, besteht nicht, wenn er abzüglich U darüber liegt, und ist dazwischen offen. Ohne Angabe wird der Wert allein verglichen. U enthält das Angegebene und sonst nichts.";
    figure: "figure", "Kenngröße";
    of: "of", "von";
    value: "value", "Wert";
    tolerance: "tolerance", "Toleranz";
    warnings: "Warnings", "Warnungen";
    no_warnings: "None.", "Keine.";
    contradiction: "Contradiction", "Widerspruch";
    few: "Few readings", "Wenige Messwerte";
    temperature: "Temperature", "Temperatur";
    outlier: "Outlier", "Ausreißer";
    unmeasured: "Not measured", "Nicht gemessen";
    note: "Note", "Hinweis";
    curves: "Error curves", "Fehlerkurven";
    curves_lead: "Readings are shown where their curve is: without what tilts add over their lever (Abbe), a straightness without its line, zero at the reference.",
        "Messwerte stehen dort, wo ihre Kurve ist: ohne Anteile der Kippungen über ihren Hebel (Abbe), Geradheit ohne ihre Ausgleichsgerade, null an der Referenz.";
    curves_stated: "These curves are stated by the machine file; no readings belong to them here.",
        "Diese Kurven stehen in der Maschinendatei; hier gehören keine Messwerte dazu.";
    positioning_of: "positioning deviation of", "Positionsabweichung von";
    straightness_of: "straightness deviation of", "Geradheitsabweichung von";
    in_direction: "in", "in";
    location_error: "location error", "Lageabweichung";
    radial_of: "radial error motion of", "Radialbewegung von";
    axial_of: "axial error motion of", "Axialbewegung von";
    roll_of: "roll of", "Rollen von";
    rotation_of: "tilt of", "Kippung von";
    about: "about", "um";
    forward: "forward", "vorwärts";
    backward: "backward", "rückwärts";
    both: "both", "beide";
    run: "run", "Lauf";
    mean: "mean", "Mittel";
    readings: "readings", "Messwerte";
    curve: "curve", "Kurve";
    residual: "residual", "Restabweichung";
    residuals: "residuals: mean reading minus curve", "Restabweichungen: mittlerer Messwert minus Kurve";
    deviation: "deviation", "Abweichung";
    band_curve: "95 % of the curve", "95 % der Kurve";
    band_one_run: "95 % of the curve, from one run", "95 % der Kurve, aus einem Lauf";
    band_note: "The band holds the true curve with a probability of 95 % at each place by itself: the runs are drawn again as a whole (bootstrap), with Student's t for few of them, and what the curve misses of readings that are left out is added.",
        "Das Band enthält die wahre Kurve an jeder Stelle für sich mit 95 % Wahrscheinlichkeit: Die Läufe werden als Ganze neu gezogen (Bootstrap), bei wenigen mit Students t, und was die Kurve an weggelassenen Messwerten verfehlt, kommt hinzu.";
    band_one_run_note: "With one run its residuals are drawn again: what differs from run to run is not in the band.",
        "Bei einem Lauf werden seine Restabweichungen neu gezogen: Was von Lauf zu Lauf verschieden ist, ist im Band nicht enthalten.";
    no_band: "No band: the readings of this curve are no runs of their own (tilts of a bridge that are summed up, or lines of other errors), or too few to be drawn again.",
        "Kein Band: Die Messwerte dieser Kurve sind keine eigenen Läufe (aufsummierte Kippungen einer Brücke oder Linien anderer Fehler) oder zu wenige, um sie neu zu ziehen.";
    bridge_note: "Tilts of a bridge, summed up: only means are shown.", "Kippungen einer Brücke, aufsummiert: nur Mittelwerte.";
    parallel_note: "Found from several parallel lines of other errors.", "Aus mehreren parallelen Linien anderer Fehler bestimmt.";
    smallest: "smallest", "kleinste";
    largest: "largest", "größte";
    rms: "rms", "RMS";
    leave_one_out: "leave-one-out", "Leave-one-out";
    reversal: "reversal", "Umkehrspanne";
    numbers_note: "Residual: mean reading minus curve. Leave-one-out: root mean square of what the curve misses of readings that were left out of its fit one at a time.",
        "Restabweichung: mittlerer Messwert minus Kurve. Leave-one-out: quadratisches Mittel dessen, was die Kurve an einzeln weggelassenen Messwerten verfehlt.";
    positioning: "Positioning tests (ISO 230-2)", "Positioniergenauigkeit (ISO 230-2)";
    no_positioning: "No positioning test among the measurements.", "Keine Positioniermessung unter den Messungen.";
    positioning_lead: "Readings as they are in the file. A, R, E, M and B are marked where they arise.",
        "Messwerte wie in der Datei. A, R, E, M und B sind dort markiert, wo sie entstehen.";
    limits: "mean ± 2 s", "Mittel ± 2 s";
    bidirectional: "bidirectional", "beidseitig";
    a: "A accuracy", "A Genauigkeit";
    r: "R repeatability", "R Wiederholpräzision";
    e: "E systematic error", "E systematische Abweichung";
    m: "M mean error", "M mittlere Abweichung";
    b: "B reversal error", "B Umkehrspanne";
    mean_b: "mean reversal error", "mittlere Umkehrspanne";
    e_before_2014: "E systematic deviation", "E systematische Abweichung";
    m_before_2014: "M mean deviation", "M mittlere Abweichung";
    b_before_2014: "B reversal value", "B Umkehrspanne";
    mean_b_before_2014: "mean reversal value", "mittlere Umkehrspanne";
    vdi_lacks: "VDI/DGQ 3441 is not evaluated: it needs both directions and at least two runs in each.",
        "VDI/DGQ 3441 ist nicht auswertbar: Es braucht beide Richtungen und mindestens zwei Läufe je Richtung.";
    vdi_words: "P positional uncertainty, Pa position deviation, U reversal, Ps scatter (6 s); a bar is the mean over the targets.",
        "P Positionsunsicherheit, Pa Positionsabweichung, U Umkehrspanne, Ps Positionsstreubreite (6 s); ein Strich ist das Mittel über die Zielpunkte.";
    u_expanded: "U (k = 2)", "U (k = 2)";
    no_u: "no uncertainty given", "keine Unsicherheit angegeben";
    standing: "In the pictures stand still:", "In den Bildern stehen still:";
    standing_note: "The table and the verdict cover poses of all axes; the pictures show this one.",
        "Tabelle und Urteil gelten für Stellungen aller Achsen; die Bilder zeigen diese eine.";
    a_missing: "A and R need at least two runs in a direction.", "A und R brauchen mindestens zwei Läufe je Richtung.";
    table_cut: "targets in all; the table shows those with the extreme values and evenly spaced ones between.",
        "Zielpunkte insgesamt; die Tabelle zeigt die mit den Extremwerten und gleichmäßig verteilte dazwischen.";
    squareness: "Squareness", "Rechtwinkligkeit";
    squareness_lead: "The angle of each pair of axes less 90°, drawn much larger than it is; dashed: 90°.",
        "Der Winkel jedes Achsenpaars minus 90°, stark überhöht gezeichnet; gestrichelt: 90°.";
    no_squareness: "No squareness is known.", "Keine Rechtwinkligkeit bekannt.";
    pair: "pair", "Paar";
    angle: "angle − 90°", "Winkel − 90°";
    from: "from", "aus";
    known_from: "known from", "bekannt aus";
    measured_here: "this calibration", "dieser Kalibrierung";
    of_file: "the machine file", "der Maschinendatei";
    locations: "Other location errors", "Weitere Lageabweichungen";
    error: "error", "Fehler";
    uncertainty_k1: "standard uncertainty", "Standardunsicherheit";
    diagonals: "Body diagonals (ISO 230-6)", "Raumdiagonalen (ISO 230-6)";
    diagonals_lead: "Computed from the model: the deviation along each diagonal of the travels, zero at its first target.",
        "Aus dem Modell berechnet: die Abweichung entlang jeder Diagonale der Verfahrwege, null am ersten Zielpunkt.";
    no_diagonals: "Not computed: they need the axes X, Y and Z.", "Nicht berechnet: Sie brauchen die Achsen X, Y und Z.";
    diagonal: "diagonal", "Diagonale";
    along: "place along the diagonal, mm", "Ort auf der Diagonale, mm";
    range: "range", "Spannweite";
    before: "before", "vorher";
    after: "after", "nachher";
    state_found: "the errors that were found, without compensation", "die gefundenen Fehler, ohne Kompensation";
    state_given: "the errors of the machine file that was stated as the state before", "die Fehler der Maschinendatei, die als Zustand vorher angegeben ist";
    state_truth: "the errors of the machine file that was stated as the truth, without compensation", "die Fehler der Maschinendatei, die als Wahrheit angegeben ist, ohne Kompensation";
    state_corrected: "what the compensation by this model leaves of the stated truth", "was die Kompensation mit diesem Modell von der angegebenen Wahrheit übrig lässt";
    state_found_after: "the errors that were found", "die gefundenen Fehler";
    no_after: "What a compensation leaves is not shown: the model against itself would prove nothing. It needs a truth or a second measurement.",
        "Was eine Kompensation übrig lässt, ist nicht gezeigt: Das Modell gegen sich selbst bewiese nichts. Nötig sind eine Wahrheit oder eine zweite Messung.";
    measured_alone: "of the measured errors alone", "allein aus den gemessenen Abweichungen";
    largest_volume: "largest volumetric error over all axes, after alignment, in the last state", "größter volumetrischer Fehler über alle Achsen, nach der Ausrichtung, im letzten Zustand";
    volume: "Volumetric error", "Volumetrischer Fehler";
    no_volume: "A map needs two of the axes X, Y and Z.", "Eine Karte braucht zwei der Achsen X, Y und Z.";
    volume_lead: "Length of the error of the tool tip after best-fit rigid-body alignment of the workpiece, on planes through the middle of the working space. One colour scale for all maps.",
        "Länge des Fehlers der Werkzeugspitze nach der Ausrichtung des Werkstücks (Starrkörper), auf Ebenen durch die Mitte des Arbeitsraums. Eine Farbskala für alle Karten.";
    state: "state", "Zustand";
    max: "largest", "größter";
    at: "at", "bei";
    tilt: "largest tilt of the tool axis", "größte Neigung der Werkzeugachse";
    whole_max: "before alignment: largest", "vor der Ausrichtung: größter";
    rigid_note: "The workpiece is aligned once for all poses and tools (best-fit rigid body: three shifts and three small rotations by least squares): where it lies is a convention and no error of the machine. Largest values are searched from the worst poses. The last two columns are before alignment.",
        "Das Werkstück ist einmal für alle Stellungen und Werkzeuge ausgerichtet (Starrkörper: drei Verschiebungen und drei kleine Drehungen, kleinste Quadrate): Seine Lage ist Festlegung und kein Fehler der Maschine. Größte Werte werden von den schlechtesten Stellungen aus gesucht. Die letzten beiden Spalten sind vor der Ausrichtung.";
    plane: "plane", "Ebene";
    scale_word: "length of the error, µm", "Länge des Fehlers, µm";
    uncompensated: "uncompensated", "unkompensiert";
    vectors: "Error vectors", "Fehlervektoren";
    vectors_hint: "Each line begins with a dot at its place and points along the error, enlarged as the rule says.",
        "Jede Linie beginnt mit einem Punkt an ihrem Ort und zeigt in Richtung des Fehlers, vergrößert wie der Maßstab sagt.";
    vectors_turn: "Drag to turn, or use the arrow keys.", "Ziehen dreht, die Pfeiltasten auch.";
    arrow_word: "an error of", "ein Fehler von";
    nodes: "poses over the travels of all axes", "Stellungen über die Wege aller Achsen";
    uncertainty: "Uncertainty", "Unsicherheit";
    no_uncertainty: "Not evaluated: no contributions are stated and no machines were drawn.", "Nicht ausgewertet: Es sind keine Beiträge angegeben und keine Maschinen gezogen.";
    not_drawn: "The volumetric error's uncertainty was not computed (no machines were drawn).",
        "Die Unsicherheit des volumetrischen Fehlers wurde nicht berechnet (keine Maschinen gezogen).";
    uncertainty_lead: "Of the position error over poses of all axes: the readings are drawn again from their scatter and from the stated contributions, and the spread of the machines that they give is the standard uncertainty (JCGM 101).",
        "Des Positionsfehlers über Stellungen aller Achsen: Die Messwerte werden aus ihrer Streuung und den angegebenen Beiträgen neu gezogen; die Streuung der so erhaltenen Maschinen ist die Standardunsicherheit (JCGM 101).";
    expanded: "expanded, k = 2", "erweitert, k = 2";
    trials: "machines drawn", "gezogene Maschinen";
    seed: "seed", "Startwert";
    contributions: "Stated contributions (standard uncertainty, k = 1)", "Angegebene Beiträge (Standardunsicherheit, k = 1)";
    not_counted: "Not counted", "Nicht enthalten";
    c_laser: "scale of the laser, material temperature included", "Maßstab des Lasers einschließlich Materialtemperatur";
    c_square: "reference angle of each squareness", "Referenzwinkel jeder Rechtwinkligkeit";
    c_reading: "mean linear reading at a target", "mittlerer Längenmesswert an einem Zielpunkt";
    c_reading_angle: "mean angular reading at a target", "mittlerer Winkelmesswert an einem Zielpunkt";
    open: "What was not measured", "Was nicht gemessen wurde";
    open_lead: "An error that nothing measured is taken as the machine file has it, or as 0. The model then does not contain it, a compensation cannot remove it, and neither the volumetric error nor its uncertainty above counts it.",
        "Ein Fehler, den nichts gemessen hat, gilt wie in der Maschinendatei angegeben, sonst als 0. Das Modell enthält ihn dann nicht, eine Kompensation kann ihn nicht entfernen, und weder der volumetrische Fehler noch dessen Unsicherheit oben zählt ihn mit.";
    open_nothing: "Every error of the structure was measured or found.", "Jeder Fehler der Struktur wurde gemessen oder gefunden.";
    open_machine: "This report is of a machine file: nothing was measured here.", "Dieser Bericht gilt einer Maschinendatei: Hier wurde nichts gemessen.";
    identified: "Identifiability", "Identifizierbarkeit";
    identified_lead: "Found from observations of the whole machine.", "Aus Beobachtungen der ganzen Maschine bestimmt.";
    unknown: "unknown", "Unbekannte";
    unit: "unit", "Einheit";
    not_found: "not determined", "nicht bestimmt";
    given_zero: "holds if zero", "gilt, wenn null";
    rank: "rank", "Rang";
    of_unknowns: "of", "von";
    score: "score of what is determined", "Güte des Bestimmten";
    score_note: "1 is best. An unknown may be 1/score times as uncertain as if all others were known.",
        "1 ist am besten. Eine Unbekannte kann 1/Güte mal so unsicher sein, als wären alle anderen bekannt.";
    fitted_rows: "fitted rows", "angepasste Zeilen";
    left_rows: "rows left out", "weggelassene Zeilen";
    judged_rows: "judged rows", "Prüfzeilen";
    what_is_left: "what is left, µm", "Rest, µm";
    null_space: "Null space: changes that the observations do not see", "Nullraum: Änderungen, die die Beobachtungen nicht sehen";
    null_nothing: "Empty: every unknown is determined.", "Leer: Jede Unbekannte ist bestimmt.";
    redundant: "Zero by convention, and not counted", "Null durch Festlegung, nicht gezählt";
    next: "Measure next", "Als Nächstes messen";
    made_by: "Made by volcomp", "Erstellt mit volcomp";
    same_bytes: "The same input gives the same bytes.", "Gleiche Eingabe ergibt gleiche Bytes.";
}

/// The words of a language.
pub(crate) fn texts(language: Language) -> &'static Texts {
    match language {
        Language::En => &ENGLISH,
        Language::De => &GERMAN,
    }
}

/// What an error is, in words: `straightness deviation of X in Y`.
pub(crate) fn described(error: &str, t: &Texts) -> String {
    let Ok(name) = error.parse::<ErrorName>() else {
        return String::new();
    };
    let axis = name.axis;
    let letter = match name.component.mcs_index() {
        0 => 'X',
        1 => 'Y',
        _ => 'Z',
    };
    let rotary = axis.kind() == AxisKind::Rotary;
    let own = name.component.mcs_index() == axis.mcs_index();
    if name.location {
        return t.location_error.to_owned();
    }
    match MotionKind::of(name) {
        MotionKind::Positioning => format!("{} {axis}", t.positioning_of),
        _ if name.component.is_angular() && !rotary && own => format!("{} {axis}", t.roll_of),
        _ if name.component.is_angular() => {
            format!("{} {axis} {} {letter}", t.rotation_of, t.about)
        }
        _ if rotary && own => format!("{} {axis}", t.axial_of),
        _ if rotary => format!("{} {axis} {} {letter}", t.radial_of, t.in_direction),
        _ => format!("{} {axis} {} {letter}", t.straightness_of, t.in_direction),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn errors_are_described_in_both_languages() {
        let [en, de] = [Language::En, Language::De].map(texts);
        for (error, english, german) in [
            (
                "EXX",
                "positioning deviation of X",
                "Positionsabweichung von X",
            ),
            (
                "EYX",
                "straightness deviation of X in Y",
                "Geradheitsabweichung von X in Y",
            ),
            ("EAX", "roll of X", "Rollen von X"),
            ("ECY", "tilt of Y about Z", "Kippung von Y um Z"),
            (
                "ECC",
                "positioning deviation of C",
                "Positionsabweichung von C",
            ),
            (
                "EXC",
                "radial error motion of C in X",
                "Radialbewegung von C in X",
            ),
            ("EZC", "axial error motion of C", "Axialbewegung von C"),
            ("EC0Y", "location error", "Lageabweichung"),
            ("<b>", "", ""),
        ] {
            assert_eq!(described(error, en), english);
            assert_eq!(described(error, de), german);
        }
    }
}
