//! The kinds of data that a machine's effects show in.

use clap::ValueEnum;

/// A kind of data.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum DataKind {
    /// RTCP deviation vectors over B, C, direction, time, temperature
    Rtcp,
    /// Edge points of a check rod in pixels
    Rod,
    /// Ball bar length over B with Z linked
    Ballbar,
    /// Thermal error over position and temperatures
    Thermal,
    /// Burn test offsets over height, power, B, time
    Burn,
}

impl DataKind {
    /// What to do where a name is none of a kind.
    pub(crate) const FIX: &str = "write rtcp, rod, ballbar, thermal or burn";

    /// The name on the command line, in files and in results.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Rtcp => "rtcp",
            Self::Rod => "rod",
            Self::Ballbar => "ballbar",
            Self::Thermal => "thermal",
            Self::Burn => "burn",
        }
    }

    /// Whether such data cannot be predicted without knowing where the head's rotary axis is.
    pub(crate) fn needs_head(self) -> bool {
        matches!(self, Self::Rtcp | Self::Ballbar)
    }

    /// Whether a kind has that name.
    pub(crate) fn has(name: &str) -> bool {
        Self::value_variants().iter().any(|kind| kind.name() == name)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_command_line_and_the_advice_have_the_names() {
        for kind in DataKind::value_variants() {
            assert_eq!(kind.to_possible_value().unwrap().get_name(), kind.name());
            assert!(DataKind::FIX.contains(kind.name()));
        }
    }
}
