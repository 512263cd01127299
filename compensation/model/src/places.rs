//! Where a machine has to be looked at, so that nothing of its errors falls between the places that are looked at.

use volcomp_curve::Field;

use crate::Machine;

impl Machine {
    /// The places along each axis, mm or deg, at which a curve of the machine has to be looked at: its nodes, and as many
    /// between them as its kind takes ([`Curve::places`](volcomp_curve::Curve::places)). Places at equal distances meet an
    /// error that repeats with the pitch of a screw at its zeros only. Within the travel, or what an axis with `modulo` has of
    /// it; its ends are among them. Rising, none twice.
    pub fn places(&self) -> Vec<Vec<f64>> {
        let mut places: Vec<Vec<f64>> = self.axes().iter().map(|axis| axis.travel.into()).collect();
        for (name, curve) in self.errors() {
            for field in curve.fields() {
                match field {
                    Field::Curve(curve) => {
                        let own = self.index_of(name.axis).ok();
                        if let Some(places) = own.and_then(|own| places.get_mut(own)) {
                            places.extend(curve.places());
                        }
                    }
                    Field::Grid(grid) => {
                        for (axis, nodes) in grid.axes().into_iter().zip(grid.nodes()) {
                            if let Some(places) = places.get_mut(axis) {
                                places.extend(nodes);
                            }
                        }
                    }
                }
            }
        }
        for (places, axis) in places.iter_mut().zip(self.axes()) {
            let [low, high] = axis.travel;
            places.retain(|place| (low..=high).contains(place));
            places.sort_by(f64::total_cmp);
            places.dedup();
        }
        places
    }
}
