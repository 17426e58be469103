//! What a script does in the window, in place of hands: for tests, and for the pictures of the documentation.
//!
//! `docs/viewer.md` lists the commands. One is done per frame, so that the window has seen what came before.

use super::bindings::Key;
use super::navigate::Button;
use std::path::PathBuf;
use std::time::Duration;

/// Where something is done.
#[derive(Clone, Debug, PartialEq)]
pub enum At {
    /// A place on the window, in points.
    Place([f32; 2]),
    /// A widget, by name.
    Widget(String),
}

/// A step.
#[derive(Clone, Debug, PartialEq)]
pub enum Step {
    /// Until everything is there that was asked for.
    WaitComplete,
    /// Until so many points are drawn.
    WaitPoints(u32),
    /// So long.
    Wait(Duration),
    /// The pointer goes there.
    Point(At),
    /// A button goes down or up.
    Button(Button, bool),
    /// The wheel turns.
    Wheel(f32),
    /// A key goes down or up.
    Key(Key, bool),
    /// Text is typed.
    Text(String),
    /// The window gets this size.
    Size([u32; 2]),
    /// The window as it is, to a PNG file.
    Shot(PathBuf),
    /// The state as one line of JSON on stdout.
    State,
    /// The window's surface is lost.
    LoseSurface,
    /// The device is lost.
    LoseDevice,
    /// The window closes.
    Quit,
}

/// Reads a script: a command a line, `#` begins a comment.
///
/// # Errors
///
/// The line's number and what is wrong with it.
pub fn parse(text: &str) -> Result<Vec<Step>, String> {
    let mut steps = Vec::new();
    for (number, line) in (1..).zip(text.lines()) {
        let line = line.split('#').next().unwrap_or("").trim();
        if line.is_empty() {
            continue;
        }
        steps.extend(parse_line(line).ok_or_else(|| format!("line {number}: \"{line}\" is no command"))?);
    }
    Ok(steps)
}

fn parse_line(line: &str) -> Option<Vec<Step>> {
    let (word, rest) = line.split_once(' ').unwrap_or((line, ""));
    let words: Vec<&str> = rest.split_whitespace().collect();
    let number = |i: usize| words.get(i).and_then(|w| w.parse::<f32>().ok()).filter(|n| n.is_finite());
    let whole = |i: usize| words.get(i).and_then(|w| w.parse::<u32>().ok());
    let at = |i: usize| match words.get(i)?.strip_prefix('@') {
        Some(name) => Some(At::Widget(name.replace('~', " "))),
        None => Some(At::Place([number(i)?, number(i + 1)?])),
    };
    let left = |down| Step::Button(Button::Left, down);
    Some(match (word, words.first().copied()) {
        ("wait", Some("complete")) => vec![Step::WaitComplete],
        ("wait", Some("points")) => vec![Step::WaitPoints(whole(1)?)],
        ("wait", Some(_)) => vec![Step::Wait(Duration::from_millis(whole(0)?.into()))],
        ("point", _) => vec![Step::Point(at(0)?)],
        ("click", _) => vec![Step::Point(at(0)?), left(true), left(false)],
        ("double", _) => vec![Step::Point(at(0)?), left(true), left(false), left(true), left(false)],
        ("drag", Some(which)) => {
            let which = button(which)?;
            let (from, to) = ([number(1)?, number(2)?], [number(3)?, number(4)?]);
            let between = [(from[0] + to[0]) / 2.0, (from[1] + to[1]) / 2.0];
            let point = |p| Step::Point(At::Place(p));
            vec![point(from), Step::Button(which, true), point(between), point(to), Step::Button(which, false)]
        }
        ("wheel", _) => vec![Step::Wheel(number(0)?)],
        ("key", Some(name)) => vec![Step::Key(key(name)?, true), Step::Key(key(name)?, false)],
        ("down", Some(name)) => vec![Step::Key(key(name)?, true)],
        ("up", Some(name)) => vec![Step::Key(key(name)?, false)],
        ("text", Some(_)) => vec![Step::Text(rest.trim().to_owned())],
        ("size", _) => vec![Step::Size([whole(0)?, whole(1)?])],
        ("shot", Some(_)) => vec![Step::Shot(PathBuf::from(rest.trim()))],
        ("state", None) => vec![Step::State],
        ("lose", Some("surface")) => vec![Step::LoseSurface],
        ("lose", Some("device")) => vec![Step::LoseDevice],
        ("quit", None) => vec![Step::Quit],
        _ => return None,
    })
}

fn button(word: &str) -> Option<Button> {
    Some(match word {
        "left" => Button::Left,
        "middle" => Button::Middle,
        "right" => Button::Right,
        _ => return None,
    })
}

/// The key that a script names.
pub fn key(name: &str) -> Option<Key> {
    Some(match name {
        "W" => Key::W,
        "A" => Key::A,
        "S" => Key::S,
        "D" => Key::D,
        "F" => Key::F,
        "G" => Key::G,
        "H" => Key::H,
        "L" => Key::L,
        "M" => Key::M,
        "O" => Key::O,
        "P" => Key::P,
        "B" => Key::B,
        "1" => Key::Digit(1),
        "2" => Key::Digit(2),
        "3" => Key::Digit(3),
        "Tab" => Key::Tab,
        "Space" => Key::Space,
        "Less" => Key::Less,
        "Ctrl" => Key::Control,
        "Shift" => Key::Shift,
        "Alt" => Key::Alt,
        "F1" => Key::F1,
        "Home" => Key::Home,
        "Esc" => Key::Escape,
        "Backspace" => Key::Backspace,
        _ => return None,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn scripts_are_read_and_refused_by_line() {
        let steps = parse(
            "# a walk\nwait complete\nkey F # fit\nclick @scan.north~2\ndrag right 1 2 3 4\nwait points 7\nquit\n",
        )
        .unwrap();
        assert_eq!((steps.len(), &steps[11]), (1 + 2 + 3 + 5 + 1 + 1, &Step::WaitPoints(7)));
        assert_eq!(steps[3], Step::Point(At::Widget("scan.north 2".into())));
        assert_eq!(steps[1], Step::Key(Key::F, true));
        for bad in ["jump", "key Hyper", "drag left 1 2 3", "size 1", "wait", "wait points", "point nan 3"] {
            let refused = parse(&format!("wait 10\n{bad}")).unwrap_err();
            assert!(refused.starts_with("line 2:"), "{refused}");
        }
    }
}
