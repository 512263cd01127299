//! From a file of observations to a machine file, with what can be said of it.
fn main() -> Result<(), Box<dyn std::error::Error>> {
    let path = std::env::args()
        .nth(1)
        .ok_or("expected a file of observations")?;
    let observations = volcomp_identify::Observations::read(path.as_ref())?;
    let found = volcomp_identify::identify(&observations, |_, _| {})?;
    for p in &found.parameters {
        if p.determined {
            println!(
                "{} {:.3} ± {:.3} {}",
                p.name,
                p.value,
                p.uncertainty.unwrap_or(0.0),
                p.unit
            );
        }
    }
    for w in &found.warnings {
        println!("note: {w}");
    }
    println!(
        "rank {} of {} score {:.2e} edf {:.1} variance {:.3}",
        found.rank,
        found.parameters.len(),
        found.score,
        found.degrees,
        found.variance
    );
    println!(
        "residual {:?} left out {:?} judged {:?} next {:?}",
        found.residual, found.left_out, found.judged, found.next
    );
    Ok(())
}
