//! How things look: four themes, each of them readable without telling colours apart.

use ratatui::style::{Color, Modifier, Style};

/// A set of styles.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Theme {
    /// Light letters on black.
    #[default]
    Dark,
    /// Dark letters on white.
    Light,
    /// No colour at all: bold, dim, underlined, reversed.
    Plain,
    /// White and yellow on black, nothing dim.
    Contrast,
}

/// What a piece of the screen is for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Role {
    /// Text.
    Text,
    /// What matters less.
    Dim,
    /// What matters more.
    Strong,
    /// All is well.
    Good,
    /// Somebody has to look.
    Warn,
    /// Something is wrong.
    Bad,
    /// What awaits the operator.
    Await,
    /// A key.
    Key,
    /// The chosen row or tab.
    Chosen,
    /// Lines around things.
    Border,
    /// The nozzle in a chart.
    Hotend,
    /// The bed in a chart.
    Bed,
}

impl Theme {
    /// All themes, in the order in which they are gone through.
    pub const ALL: [Self; 4] = [Self::Dark, Self::Light, Self::Plain, Self::Contrast];

    /// Its name, as it is given with `--theme`.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Dark => "dark",
            Self::Light => "light",
            Self::Plain => "no-colour",
            Self::Contrast => "high-contrast",
        }
    }

    /// A theme by its name.
    #[must_use]
    pub fn named(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|theme| theme.name() == name)
    }

    /// The one after this one.
    #[must_use]
    pub(super) const fn next(self) -> Self {
        match self {
            Self::Dark => Self::Light,
            Self::Light => Self::Plain,
            Self::Plain => Self::Contrast,
            Self::Contrast => Self::Dark,
        }
    }

    pub(super) const fn style(self, role: Role) -> Style {
        match self {
            Self::Dark => dark(role),
            Self::Light => light(role),
            Self::Plain => plain(role),
            Self::Contrast => contrast(role),
        }
    }
}

const fn dark(role: Role) -> Style {
    let on = Style::new().fg(Color::Gray).bg(Color::Black);
    match role {
        Role::Text => on,
        Role::Dim | Role::Border => on.fg(Color::DarkGray),
        Role::Strong => on.fg(Color::White).add_modifier(Modifier::BOLD),
        Role::Good => on.fg(Color::LightGreen),
        Role::Warn => on.fg(Color::LightYellow),
        Role::Bad => on.fg(Color::LightRed).add_modifier(Modifier::BOLD),
        Role::Await => on.fg(Color::Black).bg(Color::LightYellow).add_modifier(Modifier::BOLD),
        Role::Key => on.fg(Color::LightCyan).add_modifier(Modifier::BOLD),
        Role::Chosen => on.fg(Color::Black).bg(Color::Cyan),
        Role::Hotend => on.fg(Color::LightRed),
        Role::Bed => on.fg(Color::LightBlue),
    }
}

const fn light(role: Role) -> Style {
    let on = Style::new().fg(Color::Black).bg(Color::White);
    match role {
        Role::Text => on,
        Role::Dim | Role::Border => on.fg(Color::DarkGray),
        Role::Strong => on.add_modifier(Modifier::BOLD),
        Role::Good => on.fg(Color::Green),
        Role::Warn => on.fg(Color::Magenta),
        Role::Bad => on.fg(Color::Red).add_modifier(Modifier::BOLD),
        Role::Await => on.fg(Color::White).bg(Color::Magenta).add_modifier(Modifier::BOLD),
        Role::Key => on.fg(Color::Blue).add_modifier(Modifier::BOLD),
        Role::Chosen => on.fg(Color::White).bg(Color::Blue),
        Role::Hotend => on.fg(Color::Red),
        Role::Bed => on.fg(Color::Blue),
    }
}

const fn plain(role: Role) -> Style {
    let on = Style::new();
    match role {
        Role::Text | Role::Good | Role::Border => on,
        Role::Dim => on.add_modifier(Modifier::DIM),
        Role::Strong | Role::Key | Role::Hotend => on.add_modifier(Modifier::BOLD),
        Role::Warn => on.add_modifier(Modifier::UNDERLINED),
        Role::Bad => on.add_modifier(Modifier::BOLD.union(Modifier::UNDERLINED)),
        Role::Await => on.add_modifier(Modifier::BOLD.union(Modifier::REVERSED)),
        Role::Chosen => on.add_modifier(Modifier::REVERSED),
        Role::Bed => on.add_modifier(Modifier::DIM),
    }
}

const fn contrast(role: Role) -> Style {
    let on = Style::new().fg(Color::White).bg(Color::Black);
    match role {
        Role::Text | Role::Dim | Role::Border | Role::Bed => on,
        Role::Strong | Role::Good => on.add_modifier(Modifier::BOLD),
        Role::Key | Role::Warn | Role::Hotend => on.fg(Color::LightYellow).add_modifier(Modifier::BOLD),
        Role::Bad => on.fg(Color::Black).bg(Color::White).add_modifier(Modifier::BOLD),
        Role::Await | Role::Chosen => on.fg(Color::Black).bg(Color::LightYellow).add_modifier(Modifier::BOLD),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn themes_are_gone_through_in_a_circle_and_found_by_name() {
        for (n, theme) in Theme::ALL.into_iter().enumerate() {
            assert_eq!(theme.next(), Theme::ALL[(n + 1) % Theme::ALL.len()]);
            assert_eq!(Theme::named(theme.name()), Some(theme));
        }
        assert_eq!(Theme::named("pink"), None);
    }

    #[test]
    fn no_colour_means_none() {
        let roles = [Role::Text, Role::Dim, Role::Strong, Role::Good, Role::Warn, Role::Bad, Role::Await];
        for role in roles.into_iter().chain([Role::Key, Role::Chosen, Role::Border, Role::Hotend, Role::Bed])
        {
            let style = Theme::Plain.style(role);
            assert_eq!((style.fg, style.bg), (None, None), "{role:?}");
        }
    }
}
