//! Text in columns, for commands that list something.

/// Lines of `rows` below `head`, every column as wide as its widest cell; the last is not padded. Numbers stand to the
/// right.
pub fn lines(head: &[&str], rows: &[Vec<String>]) -> Vec<String> {
    let width = |column: usize| {
        let cells = rows.iter().filter_map(|row| row.get(column));
        let widest = cells.map(|cell| cell.chars().count()).max();
        widest.unwrap_or(0).max(head[column].chars().count())
    };
    let widths: Vec<usize> = (0..head.len()).map(width).collect();
    let is_number: Vec<bool> = (0..head.len())
        .map(|column| rows.iter().all(|row| row[column].parse::<f64>().is_ok()))
        .collect();
    let line = |cells: Vec<&str>| {
        let padded: Vec<String> = cells
            .iter()
            .zip(&widths)
            .zip(&is_number)
            .map(|((cell, width), is_number)| match is_number {
                true => format!("{cell:>width$}"),
                false => format!("{cell:<width$}"),
            })
            .collect();
        padded.join("  ").trim_end().to_owned()
    };
    let head = line(head.to_vec());
    let rows = rows
        .iter()
        .map(|row| line(row.iter().map(String::as_str).collect()));
    std::iter::once(head).chain(rows).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn columns_are_as_wide_as_their_widest_cell() {
        let row = |name: &str, number: &str, text: &str| {
            vec![name.to_owned(), number.to_owned(), text.to_owned()]
        };
        let rows = [row("a", "7.5", "x"), row("längst", "12", "yy")];
        assert_eq!(
            lines(&["name", "s", "what"], &rows),
            ["name      s  what", "a       7.5  x", "längst   12  yy"]
        );
    }
}
