//! Figures and tables of a report in a LaTeX article.

use std::ffi::OsStr;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use super::{answers, examples, missing};

/// Analyses with one figure each, appended to a manifest of short jobs.
const FIGURES: &str = "
[[analysis]]
name = \"returns\"
kind = \"curve\"
[[analysis]]
name = \"gain\"
kind = \"contrast\"
by = \"scenario\"
between = [\"P-H-D\", \"L-H-D\"]
[[analysis]]
name = \"learning\"
kind = \"learning_curve\"
window = 5
[[analysis]]
name = \"map\"
kind = \"heat_map\"
x = \"sigma\"
y = \"delta_d\"
[[analysis]]
name = \"choices\"
kind = \"action_choice\"
";

/// The files in a folder with this extension, in order.
fn files(folder: &Path, extension: &str) -> Vec<PathBuf> {
    let paths = fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path());
    let mut paths: Vec<PathBuf> =
        paths.filter(|path| path.extension().is_some_and(|end| end == extension)).collect();
    paths.sort();
    paths
}

/// The standard output of a program in a folder; the program must succeed.
fn printed(folder: &Path, program: &str, arguments: &[&str]) -> Vec<u8> {
    let output = Command::new(program).args(arguments).current_dir(folder).output().unwrap();
    let said = [&output.stdout[..], &output.stderr].concat();
    let said = String::from_utf8_lossy(&said);
    assert!(output.status.success(), "{program} {arguments:?}: {said}");
    output.stdout
}

/// The width and the brightness, from 0 to 1, of the pixels of a PNG file on white paper.
fn greys_of_png(path: &Path) -> (usize, Vec<f64>) {
    let image = tiny_skia::Pixmap::decode_png(&fs::read(path).unwrap()).unwrap();
    let grey = |pixel: &tiny_skia::PremultipliedColorU8| {
        let [red, green, blue] = [pixel.red(), pixel.green(), pixel.blue()].map(f64::from);
        let behind = 255.0 - f64::from(pixel.alpha());
        (0.299 * red + 0.587 * green + 0.114 * blue + behind) / 255.0
    };
    (image.width() as usize, image.pixels().iter().map(grey).collect())
}

/// The width and the brightness of the pixels of a page from `pdftoppm -gray`.
fn greys_of_pgm(bytes: &[u8]) -> (usize, Vec<f64>) {
    // "P5", width and height, and the largest value, on one line each.
    let head = bytes.iter().enumerate().filter(|(_, byte)| **byte == b'\n').nth(2).unwrap().0;
    let words = String::from_utf8_lossy(&bytes[..head]);
    let words: Vec<&str> = words.split_ascii_whitespace().collect();
    assert_eq!((words[0], words[3]), ("P5", "255"));
    let greys = bytes[head + 1..].iter().map(|grey| f64::from(*grey) / 255.0);
    (words[1].parse().unwrap(), greys.collect())
}

/// Means over squares of 8 by 8 pixels, because the two formats smooth edges differently.
fn coarse_greys((width, greys): &(usize, Vec<f64>), columns: usize, rows: usize) -> Vec<f64> {
    let square = |at: usize| {
        let (left, top) = (at % columns * 8, at / columns * 8);
        let row = |y: usize| greys[y * width + left..][..8].iter().sum::<f64>();
        (top..top + 8).map(row).sum::<f64>() / 64.0
    };
    (0..columns * rows).map(square).collect()
}

#[test]
fn figures_and_tables_stand_in_a_latex_article_and_a_pdf_looks_like_its_png() {
    if ["pdflatex", "pdftoppm"].iter().any(|program| !answers(OsStr::new(program), &["-v"])) {
        return missing("LaTeX (pdflatex) with pdftoppm");
    }
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let text =
        examples::manifest_of_short_jobs("article", "sigma = [0.4, 0.6]\ndelta_d = [0.1, 0.2]");
    fs::write(folder.join("article.toml"), text + FIGURES).unwrap();
    examples::run(folder, &["run", "article.toml"], 0);
    examples::run(folder, &["report", "article.toml", "--out", "report"], 0);
    let (figures, tables) =
        (files(&folder.join("report/figures"), "pdf"), files(&folder.join("report/tables"), "tex"));
    assert!(figures.len() >= 8 && tables.len() >= 4, "{figures:?} {tables:?}");

    let mut article = String::from(
        "\\documentclass[a4paper,10pt]{article}\n\\usepackage[margin=2.5cm]{geometry}\n\
         \\usepackage{booktabs,graphicx,longtable,pdflscape}\n\\begin{document}\n",
    );
    let stem = |path: &Path| path.file_stem().unwrap().to_string_lossy().into_owned();
    for path in &figures {
        let figure = format!(
            "\\includegraphics[width=\\columnwidth,height=0.9\\textheight,keepaspectratio]{{report/figures/{}.pdf}}",
            stem(path)
        );
        article += &format!("\\begin{{figure}}[p]\n{figure}\n\\end{{figure}}\n\\clearpage\n");
    }
    for path in &tables {
        article += &format!("\\input{{report/tables/{}.tex}}\n\\clearpage\n", stem(path));
    }
    fs::write(folder.join("article.tex"), article + "\\end{document}\n").unwrap();
    printed(folder, "pdflatex", &["-interaction=nonstopmode", "-halt-on-error", "article.tex"]);
    let log = String::from_utf8_lossy(&fs::read(folder.join("article.log")).unwrap()).into_owned();
    for complaint in ["Overfull", "LaTeX Warning", "pdfTeX warning", "Missing character"] {
        let line = log.lines().find(|line| line.contains(complaint));
        assert!(line.is_none(), "{line:?}");
    }
    let fonts = String::from_utf8(printed(folder, "pdffonts", &["article.pdf"])).unwrap();
    // The columns after the encoding: embedded, subset, with Unicode.
    let of_figures: Vec<&str> = fonts.lines().filter(|line| line.contains("Inter-")).collect();
    assert!(of_figures.len() >= figures.len(), "{fonts}");
    assert!(of_figures.iter().all(|line| line.contains(" yes yes yes ")), "{fonts}");
    let words = String::from_utf8(printed(folder, "pdftotext", &["article.pdf", "-"])).unwrap();
    assert!(words.matches("mean return per episode, steps walked").count() >= 3, "{words}");

    let mut compared = 0;
    for path in &figures {
        let name = format!("report/figures/{}.pdf", stem(path));
        let page = greys_of_pgm(&printed(folder, "pdftoppm", &["-r", "384", "-gray", &name]));
        let png = path.with_extension("png");
        if !png.exists() {
            continue;
        }
        let png = greys_of_png(&png);
        let height = |(width, greys): &(usize, Vec<f64>)| greys.len() / width;
        let (columns, rows) = (page.0.min(png.0) / 8, height(&page).min(height(&png)) / 8);
        assert!(page.0.abs_diff(png.0) <= 2 && height(&page).abs_diff(height(&png)) <= 2, "{name}");
        let (one, two) = (coarse_greys(&page, columns, rows), coarse_greys(&png, columns, rows));
        let ink = one.iter().map(|grey| 1.0 - grey).sum::<f64>();
        let apart = one.iter().zip(&two).map(|(one, two)| (one - two).abs()).sum::<f64>();
        println!("{}: ink {ink:.1}, apart {:.4}", stem(path), apart / ink);
        assert!(ink > 20.0 && apart < 0.12 * ink, "{name}: {apart} of {ink} differ");
        compared += 1;
    }
    println!(
        "LaTeX took {} figures and {} tables; {compared} looked like their PNG",
        figures.len(),
        tables.len()
    );
    assert!(compared >= 8, "{compared} figures were compared");
}

#[test]
fn pdflatex_takes_the_letters_that_figures_draw() {
    if !answers(OsStr::new("pdflatex"), &["-v"]) {
        return missing("LaTeX (pdflatex)");
    }
    // Labels of at most a hundred letters each, of every block of the font.
    let labels = [
        "λ → κ_h ≈ δ_h ≥ 0 ● ▲ □ ₂ ⁿ",
        "Señal règle žluťoučký ığüşöç łąka đ þ Ħ ŧ „a“ «b»",
        "Bộ đếm Ưu tiên ệ ỹ",
        "Ηλίας ΰ Ώ ϑ",
        "агент Ґанок ё ї ә Ө",
    ];
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let mut text = String::from(
        "format = 1\nname = \"letters\"\nscenarios = \"P-H-D\"\nseeds = 2\nenvironment.sigma = 0.4\n\
         evaluation.test_episodes = 2\n",
    );
    for (at, label) in labels.iter().enumerate() {
        text += &format!(
            "[[agent]]\nname = \"a{at}\"\nlabel = \"{label}\"\nalgorithm = \"rule\"\nrule = \"tailored\"\n"
        );
    }
    fs::write(folder.join("letters.toml"), text).unwrap();
    examples::run(folder, &["run", "letters.toml"], 0);
    examples::run(folder, &["report", "letters.toml", "--out", "report"], 0);
    let table = "report/tables/letters-arms.tex";
    let written = fs::read_to_string(folder.join(table)).unwrap();
    assert!(written.starts_with(
        "% Needs \\usepackage{booktabs,graphicx} and \\usepackage[T5,T2A,T1]{fontenc}.\n"
    ));
    let article = format!(
        "\\documentclass{{article}}\n\\usepackage{{booktabs,graphicx}}\n\\usepackage[T5,T2A,T1]{{fontenc}}\n\
         \\begin{{document}}\n\\input{{{table}}}\n\\end{{document}}\n"
    );
    fs::write(folder.join("letters.tex"), article).unwrap();
    printed(folder, "pdflatex", &["-interaction=nonstopmode", "-halt-on-error", "letters.tex"]);
    let log = String::from_utf8_lossy(&fs::read(folder.join("letters.log")).unwrap()).into_owned();
    assert!(!log.contains("Missing character"), "{log}");
}
