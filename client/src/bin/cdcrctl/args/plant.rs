use cdcr_controller::plant::{Flaws, RobotPreset};
use cdcr_shared_types::codes::Interface;
use clap::Args;
use clap::builder::{PossibleValuesParser, TypedValueParser};

use crate::value;

#[derive(Debug, Args)]
pub(crate) struct PlantOptions {
    /// Simulated robot, as link.simulated: laboratory (well built), sloppy (worn), slow (motors with a lag), blind (only
    /// the tip is measured), ideal (exactly its model)
    #[arg(long, value_parser = preset(), default_value = "laboratory")]
    pub(crate) preset: RobotPreset,
    /// Set a flaw, in addition to the preset or in place of its value: a name of `link.simulated_flaws` and a value in SI units;
    /// repeatable
    #[arg(long = "flaw", value_name = "NAME=VALUE", value_parser = flaw)]
    pub(crate) flaws: Vec<(String, f64)>,
    /// True geometry of a section, as `link.simulated_geometry`: length and cable radius in m, angle of the first cable in rad; once per
    /// section, base first [default: the daemon's geometry, changed by the preset]
    #[arg(long = "section", value_name = "LENGTH,RADIUS,ANGLE", value_parser = value::vector)]
    pub(crate) sections: Vec<[f64; 3]>,
    /// Part of the command to follow [default: link.interface of the daemon]
    #[arg(long, value_parser = interface())]
    pub(crate) interface: Option<Interface>,
    /// Also measure the tip, at this rate
    #[arg(long, value_name = "HZ", value_parser = value::number_in(0.01..=1000.0), allow_negative_numbers = true)]
    pub(crate) tip: Option<f64>,
    /// Start even if the robot has or had a driver: its motors would follow the commands to the simulated robot
    #[arg(long)]
    pub(crate) force: bool,
    /// Seed of the measurement noise
    #[arg(long, default_value_t = 1)]
    pub(crate) seed: u64,
}

fn preset() -> impl TypedValueParser<Value = RobotPreset> {
    PossibleValuesParser::new(RobotPreset::ALL.map(RobotPreset::name)).map(|name| {
        RobotPreset::ALL
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
        .map_err(|_| format!("invalid number {value:?}"))?;
    let (name, known) = (name.trim().to_owned(), Flaws::default());
    known
        .with(&name, value)
        .map_err(|error| error.to_string())?;
    Ok((name, value))
}

fn interface() -> impl TypedValueParser<Value = Interface> {
    let interfaces = [Interface::Velocity, Interface::Position];
    PossibleValuesParser::new(interfaces.map(Interface::text)).map(move |name| {
        let mut interfaces = interfaces.into_iter();
        interfaces
            .find(|interface| interface.text() == name)
            .unwrap_or_default()
    })
}
