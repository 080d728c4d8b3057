// SPDX-License-Identifier: Apache-2.0
/** Shapes that several modules of the pages share. */

/** An option of ECharts without colours, or what makes one for a size; ECharts judges what is in it. */
type Part =
  | ((...values: any[]) => any)
  | Part[]
  | ChartOption
  | object
  | string
  | number
  | boolean
  | null
  | undefined;
type ChartOption = { [name: string]: Part };
type Size = { width: number; height: number };
type Sized = ChartOption | ((size: Size) => ChartOption);

/** What ECharts hands to a tooltip's or a label's formatter, and to handlers of clicks. */
type Item = any;

/** A chart with its height in pixels. */
type Drawn = { height: number; option: (size: Size) => ChartOption };

/** A column of a table on a page. */
type TableColumn = {
  name: string;
  title?: string;
  kind?: string;
  factor?: number;
  sortable?: boolean;
  show?: (value: any, row: any) => any;
};
type TableData = { columns: TableColumn[]; rows: Array<Record<string, any>> };

/** Colours of text, lines and background. */
type Inks = { text: string; faint: string; line: string; back: string };

/** The settings of a page of explore. */
type Settings = {
  kind: string;
  x: string;
  y: string;
  colour: string;
  facet: string;
  down: string;
  across: string;
  outcomes: string;
  figure: 'mean' | 'median';
  xlog: boolean;
  ylog: boolean;
  own: boolean;
};

/** What an axis has to hold, and how many values lie beyond. */
type Limits = { low: number; high: number; below: number; above: number };

/** Small multiples: the settings of their charts, and what is drawn in each. */
type MultiplesSettings = Pick<Settings, 'x' | 'y' | 'down' | 'across' | 'figure' | 'xlog' | 'ylog'>;
type Multiples = {
  down: Api.Value[];
  across: Api.Value[];
  names: string[];
  cells: Array<{
    atRow: number;
    atColumn: number;
    lines: Array<{ name: string; points: Array<LinePoint & Omit<Reached, 'x'>> }>;
  }>;
  limits: Limits | null;
  ends: { min?: number; max?: number; interval?: number };
};

/** An axis of points as charts read it: places are numbers in the shown unit, or numbers of categories. */
type ReadAxis = {
  heading: Api.Heading;
  categories: string[] | null;
  at: (index: number) => number | null;
  text: (index: number) => string;
};
type CategoryAxis = ReadAxis & { categories: string[] };

/** A curve of cumulative shares in shown units; `place` says how it looks. */
type DrawnCurve = Api.Curve & { name: string; place: number };

type ErrorRange = { low: number; high: number } | null;
type View = { azimuth: number; elevation: number; zoom: number };

/** A path in space: `error` colours it where it is given; `under` draws it below all others. */
type Path = {
  name: string;
  track: Api.Track;
  colour: string;
  width: number;
  error?: Api.Numbers | null;
  under?: boolean;
};

/** What is known of the server and its archive. */
type LiveState = {
  revision: string | null;
  connected: boolean;
  problems: string[];
  counts?: Api.Counts;
};

/** What was wrong; `field` is the parameter that it was about. */
type ApiFault = { message: string; field?: string | null };

/** An answer that is there, on its way or refused; `current` only where it is of the very address. */
type Loading<T> = { data: T | null; current: T | null; error: (Error & ApiFault) | null; loading: boolean };

/** What is set anew in a query; null, '' and [] leave a name out. */
type Changes = Record<string, string | number | boolean | null | undefined | Array<string | number>>;

/** A choice: value and text, or a text that is both. */
type Offered = string | string[];

/** A saved analysis that can be asked; without settings, `needs` says which runs it needs. */
type Question = {
  title: string;
  page: string;
  needs?: string;
  settings: Record<string, string | string[]> | null;
  note?: string;
};

type OfferedGroup = { label: string; options: Offered[] };

/** A point of a line: the figure of a group at x. */
type LinePoint = { x: Api.Value; figure: Api.Figure | undefined; group: Api.Group };

/** The same on paper, in shown units. */
type Reached = {
  x: any;
  figure: Api.Figure | undefined;
  group: Api.Group;
  middle: number | null;
  low: number | null;
  high: number | null;
  interval: string | null;
};

type Axis = 'x' | 'y' | 'z';
type ChartPoint = Array<number | string | null>;

/** Paths in space, cut into chunks of one colour, and the box around them. */
type Chunk = { points: number[][]; colour: string; width: number; under: boolean };
type Scene = {
  chunks: Chunk[];
  /** Where each path begins and ends. */
  ends: Array<{ points: number[][]; colour: string }>;
  low: number[];
  high: number[];
  middle: number[];
  round: number;
  tall: number;
};

/** What stands on paper, in pixels. */
type Stroke = { points: number[][]; colour: string; width: number };
type Word = { text: string; at: number[]; colour: string };
type Paper = { lines: Stroke[]; texts: Word[] };

/** What a template may hold. */
type Shown = import('/vendor/preact.mjs').Shown;

/** An answer of several that were asked for together, or why there is none. */
type Answer<T> = { data: T | null; error: (Error & ApiFault) | null };

/** A chart of explore; without an option it cannot be drawn. */
type ChartOfSettings = {
  name: string | null;
  metric?: string;
  title?: string | null;
  left?: number;
  option: Sized | null;
  table: TableData;
};

/** A study of the runs: its tab, its address, the settings that it has. */
type Study = {
  text: string;
  path: string;
  Shown: (props: any) => Shown;
  settings: string[];
  says?: string;
};

/** What a run used, and its chart. */
type Load = { name: string; usage: Api.Usage; colour?: string };
type Truth = { name: string; track: Api.Track };
type LoadChart = { title: string; option: ChartOption; table: TableData; ofDataset: boolean };

type SpaceProps = {
  title: string;
  paths: Path[];
  range: ErrorRange;
  height?: number;
  csv?: string | true;
  table?: TableData;
  view: string;
  onView: (text: string | null) => void;
};
