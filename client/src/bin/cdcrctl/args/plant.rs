use cdcr_controller::plant::{Flaws, Preset};
use cdcr_shared_types::codes::Interface;
use clap::Args;
use clap::builder::{PossibleValuesParser, TypedValueParser};

use crate::value;

#[derive(Debug, Args)]
pub(crate) struct PlantOptions {
    /// Which robot, as link.simulated: laboratory is built well, sloppy is worn, slow has motors with a lag, of blind only
    /// the tip is measured, ideal is exactly its model
    #[arg(long, value_parser = preset(), default_value = "laboratory")]
    pub(crate) preset: Preset,
    /// What else is wrong with it, or otherwise than with the preset: its name as in `link.simulated_flaws`, and how much in SI units; may be
    /// repeated
    #[arg(long = "flaw", value_name = "NAME=VALUE", value_parser = flaw)]
    pub(crate) flaws: Vec<(String, f64)>,
    /// What a section is in truth, as `link.simulated_geometry`: length and radius of the cables in m, angle of the first in rad; once for each
    /// section, base first [default: as the daemon is configured, and what the preset makes of that]
    #[arg(long = "section", value_name = "LENGTH,RADIUS,ANGLE", value_parser = value::vector)]
    pub(crate) sections: Vec<[f64; 3]>,
    /// What of a command it obeys [default: link.interface of the daemon]
    #[arg(long, value_parser = interface())]
    pub(crate) interface: Option<Interface>,
    /// Measure the tip beside the cables, so often a second
    #[arg(long, value_name = "HZ", value_parser = value::number_in(0.01..=1000.0), allow_negative_numbers = true)]
    pub(crate) tip: Option<f64>,
    /// Also where the robot has or had a driver: its motors would follow what is commanded to the simulated robot
    #[arg(long)]
    pub(crate) force: bool,
    /// Seed of its noise
    #[arg(long, default_value_t = 1)]
    pub(crate) seed: u64,
}

fn preset() -> impl TypedValueParser<Value = Preset> {
    PossibleValuesParser::new(Preset::ALL.map(Preset::name)).map(|name| {
        Preset::ALL
            .into_iter()
            .find(|preset| preset.name() == name)
            .unwrap_or_default()
    })
}

fn flaw(text: &str) -> Result<(String, f64), String> {
    let (name, value) = text.split_once('=').ok_or("expected NAME=VALUE")?;
    let value = value
        .trim()
        .parse()
        .map_err(|_| format!("{value:?} is no number"))?;
    let (name, known) = (name.trim().to_owned(), Flaws::default());
    known
        .with(&name, value)
        .map_err(|error| error.to_string())?;
    Ok((name, value))
}

fn interface() -> impl TypedValueParser<Value = Interface> {
    PossibleValuesParser::new(["velocity", "position"]).map(|name| match &*name {
        "position" => Interface::Position,
        _ => Interface::Velocity,
    })
}
