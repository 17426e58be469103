//! Which key does what: one table, from which the help is made too.

use super::navigate::Held;
use super::rig::Mode;

/// A key by its place on the keyboard, as an American keyboard names it: so WASD lies where ZQSD does on a French one.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[allow(missing_docs)]
pub enum Key {
    W,
    A,
    S,
    D,
    Q,
    E,
    F,
    G,
    H,
    L,
    M,
    O,
    P,
    B,
    C,
    I,
    Tab,
    Space,
    Control,
    /// The key right of the left shift on European keyboards.
    Less,
    Shift,
    Alt,
    Up,
    Down,
    Left,
    Right,
    Digit(u8),
    F1,
    F2,
    F11,
    Home,
    Escape,
    Backspace,
    Delete,
}

/// What a key does when it is pressed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Command {
    /// See everything.
    Fit,
    /// From above.
    Top,
    /// From the south.
    Front,
    /// From the east.
    Side,
    /// Parallel or in perspective.
    Orthographic,
    /// Orbit, fly, walk.
    Mode(Mode),
    /// Measuring on or off.
    Measure,
    /// Keep this view.
    Bookmark,
    /// To the next scanner.
    NextStation,
    /// A picture to a file.
    Screenshot,
    /// The help.
    Help,
    /// The panels.
    Panels,
    /// Back to orbiting, or close what is open.
    Escape,
    /// Take back the last point that was measured.
    Undo,
    /// The window fills the screen, or does not.
    FullScreen,
}

/// A line of the help.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Line {
    /// Keys or mouse.
    pub keys: &'static str,
    /// What they do.
    pub does: &'static str,
}

/// A heading of the help with its lines.
pub type Chapter = (&'static str, &'static [Line]);

const fn line(keys: &'static str, does: &'static str) -> Line {
    Line { keys, does }
}

/// All that can be done with mouse and keys, for the help.
pub const HELP: &[Chapter] = &[
    (
        "Look around (orbit)",
        &[
            line("Left drag", "turn about the point under the pointer"),
            line("Right drag", "move sideways (middle drag too)"),
            line("Wheel", "nearer to, or away from, what is under the pointer"),
            line("Double click", "go there"),
        ],
    ),
    (
        "Fly and walk",
        &[
            line("W A S D", "forward, left, back, right (Z Q S D on French keyboards; arrows too)"),
            line("Space / < or Ctrl", "up / down"),
            line("Shift", "ten times faster"),
            line("Left drag", "look"),
            line("Wheel", "speed;  Alt + wheel: lean"),
            line("G", "walk: on the ground, at eye height;  G again: fly"),
            line("Esc", "back to orbit"),
        ],
    ),
    (
        "Views",
        &[
            line("F or Home", "see everything"),
            line("1  2  3", "from the top, the front, the side"),
            line("O", "parallel or in perspective"),
            line("L", "to the next scanner position"),
            line("B", "keep this view as a bookmark"),
        ],
    ),
    (
        "Tools",
        &[
            line("M", "measure: click points;  Backspace takes one back"),
            line("P", "picture to a file"),
            line("Tab", "panels on or off"),
            line("F11", "full screen"),
            line("F1 or H", "this help"),
        ],
    ),
];

/// What a newcomer needs first, in a line below the picture.
pub fn hint(mode: Mode) -> &'static [Line] {
    const ORBIT: &[Line] = &[
        line("H", "all mouse and keys"),
        line("Left drag", "turn"),
        line("Right drag", "move"),
        line("Wheel", "nearer"),
        line("Double click", "go there"),
        line("W A S D", "fly"),
        line("G", "walk"),
        line("F", "see everything"),
    ];
    const FLY: &[Line] = &[
        line("H", "all mouse and keys"),
        line("W A S D", "forward, left, back, right"),
        line("Left drag", "look"),
        line("Space / <", "up / down"),
        line("Shift", "faster"),
        line("Wheel", "speed"),
        line("Esc", "back to orbit"),
    ];
    const WALK: &[Line] = &[
        line("H", "all mouse and keys"),
        line("W A S D", "forward, left, back, right"),
        line("Left drag", "look"),
        line("Shift", "faster"),
        line("Wheel", "speed"),
        line("G", "fly"),
        line("Esc", "back to orbit"),
    ];
    match mode {
        Mode::Orbit => ORBIT,
        Mode::Fly => FLY,
        Mode::Walk => WALK,
    }
}

/// What a key does at once; none for keys that are held.
pub fn command(key: Key) -> Option<Command> {
    Some(match key {
        Key::F | Key::Home => Command::Fit,
        Key::Digit(1) => Command::Top,
        Key::Digit(2) => Command::Front,
        Key::Digit(3) => Command::Side,
        Key::O => Command::Orthographic,
        Key::G => Command::Mode(Mode::Walk),
        Key::M => Command::Measure,
        Key::B => Command::Bookmark,
        Key::L => Command::NextStation,
        Key::P | Key::F2 => Command::Screenshot,
        Key::F1 | Key::H => Command::Help,
        Key::Tab => Command::Panels,
        Key::Escape => Command::Escape,
        Key::Backspace | Key::Delete => Command::Undo,
        Key::F11 => Command::FullScreen,
        _ => return None,
    })
}

/// The movement that a key stands for as long as it is held.
pub fn held(held: &mut Held, key: Key) -> Option<&mut bool> {
    Some(match key {
        Key::W | Key::Up => &mut held.forward,
        Key::S | Key::Down => &mut held.back,
        Key::A | Key::Left => &mut held.left,
        Key::D | Key::Right => &mut held.right,
        Key::Space => &mut held.up,
        Key::Less | Key::Control => &mut held.down,
        Key::Shift => &mut held.fast,
        Key::Alt => &mut held.alt,
        _ => return None,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The help names every key that does something.
    #[test]
    fn the_help_names_what_the_keys_do() {
        let text: String =
            HELP.iter().flat_map(|(_, lines)| lines.iter()).map(|l| format!(" {} {} ", l.keys, l.does)).collect();
        for (key, word) in [
            (Key::F, "F or"),
            (Key::G, " G "),
            (Key::O, " O "),
            (Key::L, " L "),
            (Key::B, " B "),
            (Key::M, " M "),
            (Key::P, " P "),
            (Key::Tab, "Tab"),
            (Key::F1, "F1"),
            (Key::H, "or H"),
            (Key::Escape, "Esc"),
            (Key::Backspace, "Backspace"),
            (Key::F11, "F11"),
            (Key::Digit(1), "1  2  3"),
        ] {
            assert!(command(key).is_some(), "{key:?}");
            assert!(text.contains(word), "the help does not name {word}");
        }
        // And the line below the picture says how to get there, and how to get back.
        for mode in [Mode::Orbit, Mode::Fly, Mode::Walk] {
            let keys: Vec<&str> = hint(mode).iter().map(|l| l.keys).collect();
            assert!(keys.contains(&"W A S D") && keys.contains(&"H"), "{keys:?}");
            assert_eq!(keys.contains(&"Esc"), mode != Mode::Orbit, "{keys:?}");
        }
        let mut now = Held::default();
        for key in [Key::W, Key::A, Key::S, Key::D, Key::Space, Key::Less, Key::Control, Key::Shift, Key::Alt] {
            assert!(held(&mut now, key).is_some() && command(key).is_none(), "{key:?}");
        }
    }
}
