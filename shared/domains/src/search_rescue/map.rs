//! The house: walls, places, corridors, and shortest paths through it.

use super::{CELLS, CORRIDORS, PLACES, SIZE};

/// The house. `#` wall, `E` entrance, digits the places, `t` and `b` where the corridors may be blocked.
const PLAN: [&[u8; SIZE]; SIZE] = [
    b"#########", //
    b"#...t..0#",
    b"#..###..#",
    b"#..###..#",
    b"E..###.1#",
    b"#..###..#",
    b"#..###..#",
    b"#...b..2#",
    b"#########",
];

/// A cell of the map.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Cell(u8);

impl Cell {
    /// The entrance, where the person starts and the victim has to be brought.
    pub const ENTRANCE: Self = Self::new(4, 0);
    /// Where the victim may be.
    pub const PLACES: [Self; PLACES] = [Self::new(1, 7), Self::new(4, 7), Self::new(7, 7)];
    /// Where an obstacle may block the top and the bottom corridor.
    pub const CORRIDORS: [Self; CORRIDORS] = [Self::new(1, 4), Self::new(7, 4)];

    /// The cell of a row (from the top) and a column (from the left), each below [`SIZE`].
    pub const fn new(row: usize, column: usize) -> Self {
        assert!(row < SIZE && column < SIZE);
        Self((row * SIZE + column) as u8)
    }

    /// The cell of an index, row after row.
    pub const fn from_index(index: usize) -> Self {
        assert!(index < CELLS);
        Self(index as u8)
    }

    /// Row, from the top.
    pub const fn row(self) -> usize {
        self.0 as usize / SIZE
    }

    /// Column, from the left.
    pub const fn column(self) -> usize {
        self.0 as usize % SIZE
    }

    /// Index, row after row.
    pub const fn index(self) -> usize {
        self.0 as usize
    }

    /// Whether it is a wall.
    pub const fn is_wall(self) -> bool {
        PLAN[self.row()][self.column()] == b'#'
    }
}

/// The obstacle.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Obstacle {
    /// Both corridors are free.
    #[default]
    None,
    /// The top corridor is blocked.
    Top,
    /// The bottom corridor is blocked.
    Bottom,
}

impl Obstacle {
    /// All cases, in the order of scenarios.
    pub const ALL: [Self; 3] = [Self::None, Self::Top, Self::Bottom];

    /// Where it stands.
    pub fn cell(self) -> Option<Cell> {
        match self {
            Self::None => None,
            Self::Top => Some(Cell::CORRIDORS[0]),
            Self::Bottom => Some(Cell::CORRIDORS[1]),
        }
    }

    /// A bit for each blocked corridor.
    pub fn blocked(self) -> u8 {
        match self {
            Self::None => 0,
            Self::Top => 0b01,
            Self::Bottom => 0b10,
        }
    }
}

/// A number for each cell.
pub type Cells = [u8; CELLS];

/// The cell beside `cell` in the direction of an action (up, down, left, right), if it is within the house and no wall.
pub fn neighbour(cell: Cell, action: usize) -> Option<Cell> {
    let (row, column) = (cell.row(), cell.column());
    let (row, column) = match action {
        0 => (row.checked_sub(1)?, column),
        1 => (row + 1, column),
        2 => (row, column.checked_sub(1)?),
        3 => (row, column + 1),
        _ => return None,
    };
    (row < SIZE && column < SIZE)
        .then(|| Cell::new(row, column))
        .filter(|cell| !cell.is_wall())
}

/// Steps from each cell to `target` by the shortest path that avoids walls and blocked corridors (a bit each); 255 where there
/// is none. Breadth-first, allocates nothing.
pub fn distances(target: Cell, blocked: u8) -> Cells {
    let mut steps = [u8::MAX; CELLS];
    let mut queue = [target; CELLS];
    let (mut head, mut tail) = (0, 1);
    steps[target.index()] = 0;
    while head < tail {
        let cell = queue[head];
        head += 1;
        for action in 0..4 {
            let Some(next) = neighbour(cell, action) else {
                continue;
            };
            let closed = (0..CORRIDORS)
                .any(|corridor| blocked >> corridor & 1 == 1 && Cell::CORRIDORS[corridor] == next);
            if closed || steps[next.index()] != u8::MAX {
                continue;
            }
            steps[next.index()] = steps[cell.index()] + 1;
            queue[tail] = next;
            tail += 1;
        }
    }
    steps
}

/// Which actions lead a step nearer, a bit each; `steps` as [`distances`] gives them.
pub fn step_towards(steps: &Cells, from: Cell) -> u8 {
    let here = steps[from.index()];
    (0..4).fold(0, |bits, action| {
        let nearer = neighbour(from, action).is_some_and(|next| steps[next.index()] < here);
        bits | u8::from(nearer) << action
    })
}
