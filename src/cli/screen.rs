//! The full-screen view of `jitai watch`.

use std::io::{self, IsTerminal};
use std::mem;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{self, RecvTimeoutError};
use std::thread;
use std::time::Duration;

use ratatui::crossterm::event::{self, Event, KeyCode, KeyEventKind, KeyModifiers};
use ratatui::layout::{Constraint, Layout, Rect};
use ratatui::style::{Color, Modifier, Style};
use ratatui::symbols::Marker;
use ratatui::text::{Line, Span};
use ratatui::widgets::{Axis, Block, Chart, Dataset, GraphType, Paragraph, Wrap};
use ratatui::{DefaultTerminal, Frame};
use unicode_width::{UnicodeWidthChar, UnicodeWidthStr};

use crate::cli::{Error, Exit};
use crate::key::printable;
use crate::report::rounded;
use crate::store::Counts;
use crate::watch::{ArmView, Band, CurveChart, FailureView, View, ViewChoice, WatchError, Watcher};

/// Longest time between a key or a signal and its effect.
const LOOK: Duration = Duration::from_millis(100);
/// The colours of the chosen arm and of the arms beside it.
const COLOURS: [Color; 6] =
    [Color::Cyan, Color::Yellow, Color::Magenta, Color::Green, Color::Blue, Color::Red];
/// Maximum numbers of lines for running jobs, failures, races and submissions.
const LINES: usize = 3;

/// What is on the screen.
struct Progress {
    view: View,
    choice: ViewChoice,
    /// Whether the failures are shown in full in place of the curves.
    failures: bool,
    /// Why the last look failed; the view is the one before.
    error: Option<String>,
}

/// The terminal, which is restored when it is dropped, also by a panic.
struct Screen(Option<DefaultTerminal>);

impl Drop for Screen {
    fn drop(&mut self) {
        let _ = ratatui::try_restore();
        // A terminal that is gone reports its errors where they would end the process.
        if let Some(mut terminal) = self.0.take()
            && terminal.show_cursor().is_err()
        {
            mem::forget(terminal);
        }
    }
}

/// Shows the experiment until a key or a signal ends the program.
pub(super) fn show(
    watcher: Watcher,
    view: View,
    choice: ViewChoice,
    stop: &AtomicBool,
) -> Result<Exit, Error> {
    let failed = |source| Error::Io { what: "use the terminal".to_owned(), source };
    let (choices, views) = look_on(watcher, choice.clone()).map_err(failed)?;
    let mut screen = Screen(Some(ratatui::try_init().map_err(failed)?));
    let keys = listen().map_err(failed)?;
    let mut shown = Progress { view, choice, failures: false, error: None };
    loop {
        let drawn =
            screen.0.as_mut().map(|terminal| terminal.draw(|frame| draw(&shown, frame)).map(drop));
        // A closed terminal, whose signal may be ignored, has no more keys.
        if stop.load(Ordering::Relaxed) || !io::stdin().is_terminal() {
            return Ok(Exit::Interrupted);
        }
        drawn.unwrap_or(Ok(())).map_err(failed)?;
        let event = match keys.recv_timeout(LOOK) {
            Err(RecvTimeoutError::Disconnected) => return Ok(Exit::Interrupted),
            event => event,
        };
        if let Ok(Event::Key(key)) = event
            && key.kind != KeyEventKind::Release
        {
            let before = shown.choice.clone();
            let control = key.modifiers.contains(KeyModifiers::CONTROL);
            match key.code {
                KeyCode::Char('c') if control => return Ok(Exit::Interrupted),
                KeyCode::Char('q') => return Ok(Exit::Done),
                KeyCode::Esc if !shown.failures => return Ok(Exit::Done),
                code => shown.press(code),
            }
            if shown.choice != before {
                // The watcher ends only by a panic, which is reported below.
                let _ = choices.send(shown.choice.clone());
            }
        }
        loop {
            match views.try_recv() {
                Ok(Ok(view)) => (shown.view, shown.error) = (view, None),
                Ok(Err(error)) => shown.error = Some(error.to_string()),
                Err(mpsc::TryRecvError::Empty) => break,
                Err(mpsc::TryRecvError::Disconnected) => {
                    return Err(failed(io::Error::other("the watching thread has ended")));
                }
            }
        }
    }
}

/// Reads keys in a thread, because a read from a terminal that has been closed never ends.
fn listen() -> io::Result<mpsc::Receiver<Event>> {
    let (events, heard) = mpsc::channel();
    let listen = move || {
        while let Ok(event) = event::read()
            && events.send(event).is_ok()
        {}
    };
    thread::Builder::new().name("keys".to_owned()).spawn(listen)?;
    Ok(heard)
}

type Views = mpsc::Receiver<Result<View, WatchError>>;

/// Reads views in a thread, so that keys have their effect while a large store is read. A new choice is
/// read at once.
fn look_on(
    mut watcher: Watcher,
    mut choice: ViewChoice,
) -> io::Result<(mpsc::Sender<ViewChoice>, Views)> {
    let (choices, chosen) = mpsc::channel();
    let (views, seen) = mpsc::channel();
    let watch = move || {
        loop {
            let (view, pause) = match watcher.look(&choice) {
                Ok((view, pause)) => (Ok(view), pause),
                Err(error) => (Err(error), Duration::from_secs(2)),
            };
            if views.send(view).is_err() {
                return;
            }
            match chosen.recv_timeout(pause) {
                Ok(new) => choice = chosen.try_iter().last().unwrap_or(new),
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => return,
            }
        }
    };
    thread::Builder::new().name("watch".to_owned()).spawn(watch)?;
    Ok((choices, seen))
}

impl Progress {
    /// Changes what is shown.
    fn press(&mut self, key: KeyCode) {
        let Progress { view, choice, .. } = self;
        let last = view.arms.len().saturating_sub(1);
        let metrics = view.chart.metrics.max(1);
        match key {
            KeyCode::Up | KeyCode::Char('k') => choice.arm = choice.arm.saturating_sub(1),
            KeyCode::Down | KeyCode::Char('j') => choice.arm = (choice.arm + 1).min(last),
            KeyCode::PageUp => choice.arm = choice.arm.saturating_sub(10),
            KeyCode::PageDown => choice.arm = (choice.arm + 10).min(last),
            KeyCode::Home => choice.arm = 0,
            KeyCode::End => choice.arm = last,
            KeyCode::Right | KeyCode::Char('m') => choice.metric = (choice.metric + 1) % metrics,
            KeyCode::Left => choice.metric = (choice.metric + metrics - 1) % metrics,
            KeyCode::Char(' ') => match choice.beside.iter().position(|arm| *arm == choice.arm) {
                Some(index) => drop(choice.beside.remove(index)),
                None if choice.beside.len() < COLOURS.len() - 1 => choice.beside.push(choice.arm),
                None => {}
            },
            KeyCode::Char('e') => {
                let now = view.experiments.iter().position(|name| *name == view.experiment);
                let next = now.map_or(0, |now| (now + 1) % view.experiments.len());
                let experiment = view.experiments.get(next).cloned();
                *choice = ViewChoice { experiment, ..ViewChoice::default() };
            }
            KeyCode::Char('f') => self.failures = !self.failures,
            KeyCode::Esc => self.failures = false,
            _ => {}
        }
    }
}

fn draw(shown: &Progress, frame: &mut Frame<'_>) {
    let Progress { view, choice, failures, error } = shown;
    let below = below(view, *failures);
    let [title, bar, main, rest, keys] = Layout::vertical([
        Constraint::Length(1),
        Constraint::Length(1),
        Constraint::Min(6),
        Constraint::Length(below.len() as u16),
        Constraint::Length(1),
    ])
    .areas(frame.area());
    let bold = Style::new().add_modifier(Modifier::BOLD);
    let name = Span::styled(printable(&view.experiment), bold);
    let line = Line::from(vec![name, format!(": {}", view.summary()).into()]);
    frame.render_widget(line, title);
    frame.render_widget(states(&view.counts, bar.width), bar);
    if *failures {
        frame.render_widget(all_failures(view), main);
    } else {
        let longest = view.arms.iter().map(|arm| arm.name.width()).max().unwrap_or(0);
        let width = (longest as u16 + 19).min(main.width / 2);
        let [left, right] =
            Layout::horizontal([Constraint::Length(width), Constraint::Min(10)]).areas(main);
        frame.render_widget(arms(view, choice, left), left);
        draw_chart(view, frame, right);
    }
    frame.render_widget(Paragraph::new(below), rest);
    frame.render_widget(
        match error {
            Some(error) => Line::styled(printable(error), Color::Red),
            None => Line::styled(
                "↑↓ arm  space beside  ←→ metric  e experiment  f failures  q quit",
                Modifier::DIM,
            ),
        },
        keys,
    );
}

/// A bar with the share of the jobs in each state.
fn states(counts: &Counts, width: u16) -> Line<'static> {
    let total = counts.total().max(1);
    let shares = [
        (counts.completed, "█", Color::Green),
        (counts.failed, "█", Color::Red),
        (counts.running, "▒", Color::Cyan),
    ];
    let (mut jobs, mut filled) = (0, 0);
    let mut spans = Vec::new();
    for (count, sign, colour) in shares {
        jobs += count;
        let end = (u64::from(width) * jobs).div_ceil(total) as usize;
        spans.push(Span::styled(sign.repeat(end - filled), colour));
        filled = end;
    }
    spans.push(Span::styled("░".repeat(usize::from(width) - filled), Modifier::DIM));
    Line::from(spans)
}

/// The list of arms, scrolled so that the chosen one can be seen.
fn arms(view: &View, choice: &ViewChoice, area: Rect) -> Paragraph<'static> {
    let height = usize::from(area.height).saturating_sub(1).max(1);
    let first = choice.arm.saturating_sub(height - 1);
    let room = usize::from(area.width).saturating_sub(18);
    let heading = format!("  {:room$} {:>6} {:>8}", "arm", "jobs", "return");
    let all: Vec<&str> = view.arms.iter().map(|arm| arm.name.as_str()).collect();
    let line = |(index, arm): (usize, &ArmView)| {
        let ArmView { name, counts, mean_return } = arm;
        let name = shortened(name, &all, room);
        let gap = " ".repeat(room.saturating_sub(name.width()));
        let value = mean_return.map_or_else(String::new, |mean| rounded(mean, 1));
        let done = counts.completed + counts.failed;
        let jobs = format!("{done}/{}", counts.total());
        let sign = if counts.running > 0 { "▸" } else { " " };
        let text = format!("{sign} {name}{gap} {jobs:>6} {value:>8}");
        match colour(view, index) {
            _ if index == choice.arm => Line::styled(text, Modifier::REVERSED),
            Some(colour) => Line::styled(text, colour),
            None => Line::from(text),
        }
    };
    let lines = view.arms.iter().enumerate().skip(first).take(height).map(line);
    Paragraph::new(
        std::iter::once(Line::styled(heading, Modifier::DIM)).chain(lines).collect::<Vec<_>>(),
    )
}

/// The colour of an arm in the chart; `None` for an arm that is not shown there.
fn colour(view: &View, arm: usize) -> Option<Color> {
    let line = view.chart.lines.iter().position(|(shown, _)| *shown == arm)?;
    COLOURS.get(line).copied()
}

/// The numbers of seeds of the chosen arm's curve, in words.
fn seeds_of_chosen(chart: &CurveChart) -> String {
    let chosen = chart.lines.first().into_iter().flat_map(|(_, line)| line);
    let seeds: Vec<usize> = chosen.map(|one| one.seeds).collect();
    match (seeds.iter().min(), seeds.iter().max()) {
        (Some(1), Some(1)) => ", 1 seed".to_owned(),
        (Some(least), Some(most)) if least == most => format!(" ± sd, {most} seeds"),
        (Some(least), Some(most)) => format!(" ± sd, {least} to {most} seeds"),
        _ => String::new(),
    }
}

fn draw_chart(view: &View, frame: &mut Frame<'_>, area: Rect) {
    let chart = &view.chart;
    let lines = || chart.lines.iter().flat_map(|(_, line)| line);
    let Some(metric) = chart.metric else { return };
    let over = seeds_of_chosen(chart);
    let block = Block::bordered()
        .border_style(Modifier::DIM)
        .title(cut(&format!(" {metric}{over} "), usize::from(area.width).saturating_sub(2)));
    if lines().next().is_none() {
        let why = match chart.episodes {
            0 => "this arm has no learning curve: its agent does not learn in training episodes",
            _ => "no points yet; a running job adds points every few seconds",
        };
        frame.render_widget(Paragraph::new(why).wrap(Wrap { trim: true }).block(block), area);
        return;
    }
    let edge = |sign: f64| {
        let chosen = chart.lines.first().into_iter().flat_map(|(_, line)| line);
        let point = move |one: &Band| Some((one.episode, one.mean + sign * one.sd?));
        chosen.filter_map(point).collect::<Vec<(f64, f64)>>()
    };
    let edges = [edge(-1.0), edge(1.0)];
    let means: Vec<Vec<(f64, f64)>> = chart
        .lines
        .iter()
        .map(|(_, line)| line.iter().map(|one| (one.episode, one.mean)).collect())
        .collect();
    let values = || edges.iter().chain(&means).flatten().map(|point| point.1);
    let (mut low, mut high) =
        (values().fold(f64::MAX, f64::min), values().fold(f64::MIN, f64::max));
    if high - low < 1e-9 * high.abs().max(1e-9) {
        (low, high) = (low - 0.5, high + 0.5);
    }
    let line = |points, colour| {
        Dataset::default()
            .marker(Marker::Braille)
            .graph_type(GraphType::Line)
            .style(Style::new().fg(colour))
            .data(points)
    };
    // The chosen arm is drawn last, over the others.
    let mut sets: Vec<Dataset<'_>> =
        edges.iter().map(|points| line(points, Color::DarkGray)).collect();
    sets.extend(means.iter().zip(COLOURS).rev().map(|(points, colour)| line(points, colour)));
    let decimals = match high - low {
        20.0.. => 0,
        0.2.. => 2,
        _ => 4,
    };
    let label = |value: f64| rounded(value, decimals);
    let episodes = f64::from(chart.episodes);
    let x = Axis::default()
        .bounds([0.0, episodes])
        .labels(["0".to_owned(), format!("{} episodes", chart.episodes)]);
    let y = Axis::default().bounds([low, high]).labels([
        label(low),
        label((low + high) / 2.0),
        label(high),
    ]);
    frame.render_widget(Chart::new(sets).block(block).x_axis(x).y_axis(y), area);
}

/// Running jobs, failures, races and submissions, below the arms.
fn below(view: &View, failures: bool) -> Vec<Line<'static>> {
    let mut lines = Vec::new();
    let more = |all: usize| match all.saturating_sub(LINES) {
        0 => String::new(),
        more => format!(", and {more} more"),
    };
    let running = view.running.iter().take(LINES).enumerate().map(|(index, job)| {
        let part = match job.part {
            Some(part) => format!("{:>4}", format!("{:.0}%", 100.0 * part)),
            None => "   …".to_owned(),
        };
        let more = if index == LINES - 1 { more(view.running.len()) } else { String::new() };
        Line::styled(format!("{part} {}{more}", job.name), Color::Cyan)
    });
    lines.extend(running);
    if !failures {
        lines.extend(view.failures.iter().take(LINES).enumerate().map(|(index, failure)| {
            let more = if index == LINES - 1 { more(view.failures.len()) } else { String::new() };
            let FailureView { name, reason, jobs } = failure;
            Line::styled(format!("failed {jobs}×: {name}: {reason}{more}"), Color::Red)
        }));
    }
    for notes in [&view.races, &view.submissions] {
        lines.extend(notes.iter().take(LINES).map(|line| Line::from(line.clone())));
    }
    lines
}

/// The failures with their whole reasons.
fn all_failures(view: &View) -> Paragraph<'static> {
    let mut lines: Vec<Line<'_>> = Vec::new();
    for FailureView { name, reason, jobs } in &view.failures {
        lines.push(Line::styled(format!("{jobs}× like {name}"), Color::Red));
        lines.push(Line::from(reason.clone()));
    }
    if lines.is_empty() {
        lines.push(Line::from("no job has failed"));
    }
    Paragraph::new(lines).wrap(Wrap { trim: false })
}

/// A name of at most `room` columns. What it shares with all names is cut first.
fn shortened(name: &str, all: &[&str], room: usize) -> String {
    let mut letters: Vec<(char, bool)> = Vec::new();
    for word in name.split_inclusive(' ') {
        let shared = match word.split_once('=') {
            _ if all.iter().all(|one| {
                one.split_inclusive(' ').any(|other| other.trim_end() == word.trim_end())
            }) =>
            {
                word.chars().count()
            }
            Some((key, _)) if all.iter().all(|one| one.contains(&format!("{key}="))) => {
                key.chars().count() + 1
            }
            _ => 0,
        };
        let is_shared = |(index, c): (usize, char)| (c, index < shared || c == ' ');
        letters.extend(word.chars().enumerate().map(is_shared));
    }
    let columns = |letters: &[(char, bool)]| {
        letters.iter().map(|(letter, _)| letter.width().unwrap_or(0)).sum::<usize>()
    };
    while columns(&letters) > room && room > 0 {
        // One more column for the sign of the cut.
        let excess = columns(&letters) - room + 1;
        let mut indices: Vec<usize> = (0..letters.len()).collect();
        let longest = indices
            .chunk_by(|one, next| letters[*one].1 && letters[*next].1)
            .filter(|run| run.len() > 1)
            .max_by_key(|run| run.len())
            .map(<[usize]>::to_vec);
        indices = longest.unwrap_or(indices);
        let (first, last) = (indices[0], indices[indices.len() - 1]);
        let mut start = ((room - 1) / 2).clamp(first, (last + 1).saturating_sub(excess).max(first));
        let mut end = start;
        while end <= last && columns(&letters[start..end]) < excess {
            end += 1;
        }
        while start > first && columns(&letters[start..end]) < excess {
            start -= 1;
        }
        // The sign is not cut again as part of a shared run.
        letters.splice(start..end, [('…', false)]);
    }
    letters.into_iter().map(|(letter, _)| letter).collect()
}

/// A text of at most `room` columns; a cut ends in `…`.
fn cut(text: &str, room: usize) -> String {
    if text.width() <= room {
        return text.to_owned();
    }
    let mut columns = 0;
    let fits = |letter: &char| {
        columns += letter.width().unwrap_or(0);
        columns < room
    };
    text.chars().take_while(fits).chain(['…']).collect()
}

#[cfg(test)]
mod tests {
    use std::env;
    use std::io::Write as _;
    use std::process::{Command, Output, Stdio};

    use ratatui::Terminal;
    use ratatui::backend::TestBackend;

    use super::*;
    use crate::job::metric::MEAN_RETURN;
    use crate::watch::RunningView;

    fn counts(completed: u64, running: u64, pending: u64, failed: u64) -> Counts {
        Counts { completed, running, pending, failed, interrupted: 0 }
    }

    fn view() -> View {
        let arm = |name: &str, counts, mean_return| ArmView {
            name: name.to_owned(),
            counts,
            mean_return,
        };
        let point = |part: u32, sd| Band {
            episode: f64::from(part) * 10.0,
            mean: f64::from(part * 100),
            sd,
            seeds: if sd.is_some() { 3 } else { 1 },
        };
        let line = (1..=10).map(|part| point(part, (part < 8).then_some(50.0))).collect();
        View {
            experiment: "quickstart".to_owned(),
            experiments: vec!["quickstart".to_owned(), "other".to_owned()],
            counts: counts(3, 2, 4, 1),
            filter: None,
            left: Some(Duration::from_secs(200)),
            arms: vec![
                arm("dqn P-H-D sigma=0.4", counts(3, 1, 0, 0), Some(1234.56)),
                arm("reinforce P-H-D sigma=0.4", counts(0, 1, 4, 1), None),
            ],
            running: vec![
                RunningView {
                    name: "dqn P-H-D sigma=0.4 (1a2b3c4d)".to_owned(),
                    part: Some(0.456),
                },
                RunningView { name: "reinforce P-H-D sigma=0.4 (5e6f7a8b)".to_owned(), part: None },
            ],
            failures: vec![FailureView {
                name: "reinforce P-H-D sigma=0.4 seed=3".to_owned(),
                reason: "diverged (the loss of update 7 is NaN; use a smaller learning rate)"
                    .to_owned(),
                jobs: 12,
            }],
            races: vec![
                "drawn: rung 2 of 3: 1 of 4 arms open; next, the best 2 go on to 8 seeds"
                    .to_owned(),
            ],
            submissions: Vec::new(),
            held: 0,
            chart: CurveChart {
                metric: Some(MEAN_RETURN),
                metrics: 4,
                episodes: 100,
                lines: vec![(0, line)],
            },
        }
    }

    fn shown() -> Progress {
        Progress { view: view(), choice: ViewChoice::default(), failures: false, error: None }
    }

    /// The lines of a screen of this size.
    fn screen(shown: &Progress, width: u16, height: u16) -> Vec<String> {
        let mut terminal = Terminal::new(TestBackend::new(width, height)).unwrap();
        terminal.draw(|frame| draw(shown, frame)).unwrap();
        let buffer = terminal.backend().buffer();
        let line = |y| (0..width).map(|x| buffer[(x, y)].symbol()).collect::<String>();
        (0..height).map(line).collect()
    }

    #[test]
    fn a_screen_of_80_by_24_shows_everything() {
        let lines = screen(&shown(), 80, 24);
        assert_eq!(
            lines[0].trim_end(),
            "quickstart: 3 of 10 completed, 2 running, 4 pending, 1 failed, about 3 min left"
        );
        assert_eq!(lines[1].matches('█').count(), 32);
        assert_eq!(lines[1].matches('▒').count(), 16);
        assert!(lines[3].starts_with("▸ dqn P-H-D sigma=0.4 "), "{lines:#?}");
        assert!(lines[3].contains(" 3/4   1234.6"), "{lines:#?}");
        assert!(lines[4].contains("▸ reinforce …D sigma=0.4    1/6 "), "{lines:#?}");
        assert!(lines[2].contains(" mean_return ± sd, 1 to 3 seeds "), "{lines:#?}");
        let all = lines.join("\n");
        assert!(all.contains("100 episodes") && all.contains("1000"), "{all}");
        // The curve and the lines of its spread are drawn in dots.
        assert!(
            all.chars().filter(|c| ('\u{2801}'..='\u{28ff}').contains(c)).count() > 60,
            "{all}"
        );
        assert_eq!(lines[19].trim_end(), " 46% dqn P-H-D sigma=0.4 (1a2b3c4d)");
        assert_eq!(lines[20].trim_end(), "   … reinforce P-H-D sigma=0.4 (5e6f7a8b)");
        assert!(
            lines[21].starts_with("failed 12×: reinforce P-H-D sigma=0.4 seed=3: diverged (the")
        );
        let race = "drawn: rung 2 of 3: 1 of 4 arms open; next, the best 2 go on to 8 seeds";
        assert_eq!(lines[22].trim_end(), race);
        assert!(lines[23].contains("q quit"));
    }

    #[test]
    fn a_wide_name_moves_no_number_and_a_narrow_screen_keeps_what_differs() {
        let mut shown = shown();
        shown.view.arms[0].name = "日本語 P-H-D".to_owned();
        shown.view.arms[0].mean_return = Some(387.5);
        for width in [60, 80, 120] {
            assert!(screen(&shown, width, 24)[3].contains(" 387.5"));
        }
        let all = [
            "ppo P-H-D learning_rate=0.001 sigma=0.4 horizon",
            "ppo P-H-D learning_rate=0.01 sigma=0.4 horizon",
        ];
        for room in [14, 20, 30] {
            let [one, two] = all.map(|name| shortened(name, &all, room));
            assert!(one.contains("0.001") && two.contains("0.01"), "{one} {two}");
            assert!(one.width() <= room && two.width() <= room, "{one} {two}");
        }
        let wide = ["日本語のとても長い名前", "別の名前"];
        assert!((1..25).all(|room| shortened(wide[0], &wide, room).width() <= room));
        assert_eq!(cut("日本語", 4), "日…");
    }

    #[test]
    fn small_and_empty_screens_are_drawn() {
        let mut shown = shown();
        for (width, height) in [(1, 1), (10, 3), (40, 10), (300, 100)] {
            screen(&shown, width, height);
        }
        shown.view.chart.lines[0].1.clear();
        assert!(screen(&shown, 80, 24).join(" ").contains("no points yet"));
        shown.view.chart.episodes = 0;
        assert!(screen(&shown, 80, 24).join(" ").contains("no learning curve"));
        shown.view = View { experiment: "empty".to_owned(), ..View::default() };
        assert!(screen(&shown, 80, 24)[0].starts_with("empty: 0 of 0 completed"));
    }

    #[test]
    fn keys_choose_arms_metrics_and_experiments() {
        let mut shown = shown();
        let mut press = |key| {
            shown.press(key);
            shown.choice.clone()
        };
        assert_eq!(press(KeyCode::Up).arm, 0);
        assert_eq!(press(KeyCode::Down).arm, 1);
        assert_eq!(press(KeyCode::Char('j')).arm, 1);
        assert_eq!(press(KeyCode::Char(' ')).beside, [1]);
        assert_eq!(press(KeyCode::Home).arm, 0);
        assert_eq!(press(KeyCode::Left).metric, 3);
        assert_eq!(press(KeyCode::Right).metric, 0);
        assert_eq!(press(KeyCode::Char('e')).experiment.as_deref(), Some("other"));
        assert_eq!(press(KeyCode::Char('x')).experiment.as_deref(), Some("other"));
        press(KeyCode::Char('f'));
        let lines = screen(&shown, 80, 24).join("\n");
        assert!(lines.contains("12× like reinforce P-H-D sigma=0.4 seed=3"), "{lines}");
        assert!(lines.contains("use a smaller learning rate)"), "{lines}");
    }

    /// Runs itself in a pseudo terminal, where it panics while the screen is shown.
    #[test]
    fn a_panic_leaves_the_screen_before_its_message() {
        const PANICS: &str = "JITAI_TEST_PANICS";
        if env::var_os(PANICS).is_some() {
            let mut screen = Screen(Some(ratatui::try_init().unwrap()));
            let terminal = screen.0.as_mut().unwrap();
            terminal.draw(|frame| frame.render_widget("shown", frame.area())).unwrap();
            panic!("while shown");
        }
        let name = "cli::screen::tests::a_panic_leaves_the_screen_before_its_message";
        let program = env::current_exe().unwrap();
        let inner = format!("stty rows 24 cols 80; '{}' {name} --nocapture", program.display());
        let mut script = Command::new("script");
        script.args(["-qefc", &inner, "/dev/null"]).stdin(Stdio::null()).env(PANICS, "1");
        script.env("TERM", "xterm-256color").env("SHELL", "/bin/sh");
        let version = Command::new("script").arg("--version").output();
        let is_util_linux =
            |output: Output| String::from_utf8_lossy(&output.stdout).contains("util-linux");
        if !version.is_ok_and(is_util_linux) {
            let why = "the terminal after a panic: it needs `script` of util-linux";
            assert_ne!(env::var("JITAI_REQUIRE_ALL").as_deref(), Ok("1"), "{why}");
            // The test runner hides what a passing test prints, but not what it writes.
            return io::stderr().write_all(format!("left out: {why}\n").as_bytes()).unwrap();
        }
        let output = script.output().unwrap();
        let text = String::from_utf8_lossy(&output.stdout);
        assert_eq!(output.status.code(), Some(101), "{text}");
        let at = |part: &str| text.rfind(part).unwrap_or_else(|| panic!("{part:?}: {text:?}"));
        // The cursor is shown again once the terminal is dropped.
        let left = text.find("\u{1b}[?1049l").unwrap_or_else(|| panic!("{text:?}"));
        assert!(at("\u{1b}[?1049h") < left && left < at("while shown"), "{text:?}");
        assert!(at("\u{1b}[?25l") < at("\u{1b}[?25h"), "{text:?}");
    }
}
