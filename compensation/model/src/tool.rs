use volcomp_kinematics::nalgebra::Vector3;

/// A tool of the machine file. Keys that are `None` come from `[tool]`, else from the default.
#[derive(Clone, Debug, Default, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Tool {
    /// Tip of the tool, mm in the machine coordinate system at machine zero.
    pub tip_mm: Option<[f64; 3]>,
    /// Gauge point of the spindle, mm in the machine coordinate system at machine zero; alternative to `tip_mm`.
    pub gauge_mm: Option<[f64; 3]>,
    /// Length from the gauge point to the tip, mm.
    pub length_mm: Option<f64>,
    /// Offset added to the tip, mm in the machine coordinate system.
    pub offset_mm: Option<[f64; 3]>,
    /// Direction from the tip to the spindle, in the machine coordinate system at machine zero; not necessarily a unit vector.
    pub axis: Option<[f64; 3]>,
}

impl Tool {
    /// This tool, with missing keys taken from `base`.
    pub(crate) fn over(&self, base: &Self) -> Self {
        // A tip replaces the gauge point and its keys, and vice versa.
        let (keeps_tip, keeps_gauge) = (self.gauge_mm.is_none(), self.tip_mm.is_none());
        Self {
            tip_mm: self.tip_mm.or(base.tip_mm.filter(|_| keeps_tip)),
            gauge_mm: self.gauge_mm.or(base.gauge_mm.filter(|_| keeps_gauge)),
            length_mm: self.length_mm.or(base.length_mm.filter(|_| keeps_gauge)),
            offset_mm: self.offset_mm.or(base.offset_mm.filter(|_| keeps_gauge)),
            axis: self.axis.or(base.axis),
        }
    }

    /// Tip and axis: tip = gauge − length·axis + offset.
    pub(crate) fn tip_and_axis(&self) -> ([f64; 3], [f64; 3]) {
        let axis = self.axis.unwrap_or([0.0, 0.0, 1.0]);
        let Some(gauge) = self.gauge_mm else {
            return (self.tip_mm.unwrap_or_default(), axis);
        };
        let unit = Vector3::from(axis).try_normalize(0.0).unwrap_or_default();
        let tip = Vector3::from(gauge) - unit * self.length_mm.unwrap_or(0.0)
            + Vector3::from(self.offset_mm.unwrap_or_default());
        (tip.into(), axis)
    }
}
