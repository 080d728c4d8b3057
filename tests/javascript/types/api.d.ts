// SPDX-License-Identifier: Apache-2.0
/**
 * What the API answers, as far as the pages read it. answers.ts holds kept answers of a dashboard against
 * these types, and tests/dashboard_pages/test_answers.py holds today's answers against the kept ones.
 */
declare namespace Api {
  type Value = string | number | boolean | null;
  type Keys = Record<string, Value>;
  type Counts = Record<string, number | undefined>;
  type Numbers = Array<number | null>;

  /** What is drawn of a sensor's messages; times in s since the recording's start. */
  type SensorView = {
    name: string;
    type: string;
    topic: string;
    messages: number;
    first: number | null;
    last: number | null;
    rates: number[];
    gaps: number[][];
    pictures: Array<{ t: number; data: string }>;
    clouds: Array<{ t: number; x: number[]; y: number[] }>;
    imu: Record<string, Record<string, Numbers[]>>;
  };

  /** What is drawn of a dataset's recording. */
  type Overview = {
    name: string;
    start: number;
    seconds: number;
    sensors: SensorView[];
    truth: {
      count: number;
      first: number;
      last: number;
      t: number[];
      x: number[];
      y: number[];
      z: number[];
    } | null;
    notes: string[];
  };

  /** A number of a paper or leaderboard, beside own runs; `values` in stored units by column. */
  type PublishedRow = {
    system: string;
    dataset: string;
    where: string;
    url: string | null;
    title: string;
    alignment: string | null;
    statistic: string | null;
    runs: number | null;
    notes: string | null;
    values: Record<string, number>;
    differences: string[];
    /** By column, a sentence on own runs beside the number. */
    verdicts: Record<string, string>;
    isDrawn: boolean;
  };

  /** A column as tables and charts need it; `kind` is number, integer, time, text, boolean or other. */
  type Heading = {
    name: string;
    title: string;
    label?: string;
    kind?: string;
    unit?: string | null;
    factor?: number;
    /** Which way is good; null where nobody has said so. */
    better?: string | null;
  };
  type Column = Heading & {
    kind: string;
    group: string;
    count: number;
    distinct: number;
    values?: Array<{ value: Value; count: number }>;
    min?: Value;
    max?: Value;
  };
  /** `varied`: settings by which runs of one algorithm on one dataset differ. */
  type Columns = { rows: number; items: Column[]; varied: string[]; notes: string[] };

  type Index = {
    revision: string;
    counts: Counts;
    statuses: Counts;
    problems: string[];
  };

  type Condition = { type: string; status: string; reason?: string | null; message?: string | null };
  type Sweep = {
    uid: string | null;
    name: string;
    search: string | null;
    namespace: string | null;
    live: boolean;
    total: number | null;
    runs: number;
    superseded: number;
    versions: number;
    phases: Counts;
    statuses: Counts;
    algorithms: string[];
    datasets: string[];
    started: string | null;
    finished: string | null;
    created: string | null;
    axes: Array<{ name: string; count: number }>;
    best: Array<{ name: string; ate: number; dataset: string | null }>;
    single: boolean;
    spread: Array<{
      algorithm: string;
      low: number | null;
      median: number | null;
      high: number | null;
      failed: number;
    }>;
    spec?: object | null;
    manifest?: string | null;
    evaluation?: object | null;
    conditions?: Condition[];
  };

  type Sweeps = {
    items: Sweep[];
    single: { runs: number; without: number; live: boolean; statuses: Counts; finished: string | null };
  };

  type Entry = {
    name: string;
    description: string | null;
    labels: Record<string, Value>;
    attributes: Record<string, Value>;
    runs: number;
    modes: string[];
    statuses: Counts;
    algorithms?: string[];
    datasets?: string[];
    manifest?: string | null;
    versions?: number;
    parameters?: Record<string, object>;
    sensors?: Record<string, object>;
  };

  type Row = Record<string, Value>;
  /** `same`: columns in which all runs that are meant have one value. */
  type Runs = {
    total: number;
    next: string | null;
    same: string[];
    columns: Heading[];
    items: Row[];
    notes: string[];
  };
  type Run = {
    uid: string;
    name: string;
    run: Value;
    sweep: string | null;
    phase: string;
    reason: string | null;
    message: string | null;
    configuration: Record<string, any> | null;
    /** Settings by which runs of the algorithm on the dataset differ. */
    varied: Heading[];
    cameras: boolean;
    results: Array<Record<string, any>>;
    notes: string[];
    usage: Record<string, any> | null;
    /** What columns of costs, frames and own metrics are called. */
    labelled: Record<string, string>;
    provenance: Record<string, any> | null;
    manifest: string | null;
    logTail: string | null;
    files: boolean;
    absence: string | null;
    links: Record<string, string>;
  } & Record<string, any>;

  type Search = {
    total: number;
    keys: Heading[];
    items: Array<{ uid: string; run: Value; status: string; keys: Keys }>;
    notes: string[];
  };

  type Clock = { start: number; of: string };
  type Track = { t: number[]; x: number[]; y: number[]; z: number[]; error?: Numbers | null };
  type Trajectory = {
    clock: Clock;
    evaluation: string | null;
    alignment: string | null;
    poses: number;
    shown: number;
    estimate: Track;
    reference: Track | null;
    /** Control points, where the ground truth is such. */
    points?: Track | null;
    notes: string[];
  };
  type PathGroup = {
    facets: Keys;
    reference: Track | null;
    runs: Array<{
      uid: string;
      run: Value;
      status: string;
      coverage: number | null;
      keys: Keys;
      error: number | null;
      track: Track | null;
      problem: string | null;
    }>;
    notes: string[];
  };
  type Paths = { rows: number; by: string[]; groups: PathGroup[]; notes: string[] };
  type Timeline = {
    runs: number;
    failed: number;
    live: number;
    whole: [number | null, number | null];
    extent: [number | null, number | null];
    lanes: string[];
    bars: {
      keys: Heading[];
      settings: Keys[];
      uid: string[];
      run: Value[];
      status: string[];
      lane: number[];
      begin: number[];
      start: Numbers;
      end: number[];
      failed: boolean[];
      live: boolean[];
    } | null;
    bins: {
      edges: number[];
      running: number[][];
      preparing: number[][];
      ended: number[][];
      failed: number[][];
    } | null;
    notes: string[];
  };
  type Images = { t: number; images: Array<{ topic: string; stamp: number; data: string }> };
  type Usage = {
    clock: Clock | null;
    t: number[];
    cpu: Numbers;
    memory: Numbers;
    anonymous: Numbers | null;
    kind: string | null;
    samples: number;
    stamp: number[] | null;
    /** The reader's part of all CPU seconds, which the curve holds. */
    readerShare: number | null;
    notes: string[];
  };

  type Interval = { low: number | null; high: number | null; method?: string };
  type Figure = {
    n: number;
    mean: number | null;
    std: number | null;
    median: number | null;
    min: number | null;
    max: number | null;
    points?: number[];
    meanInterval?: Interval | null;
    medianInterval?: Interval | null;
  };
  type Failures = Counts;
  type Group = {
    keys: Keys;
    runs: number;
    n: number;
    copies: number;
    failed: number;
    failures: Failures;
    deterministic: boolean;
    findings: string[];
    reader: boolean;
    /** Whether memory holds frames that waited. */
    late: boolean;
    /** Whether a search chose some of its runs by its results. */
    chosen: boolean;
    coverage: Figure | null;
    figures: Record<string, Figure>;
  };
  type Aggregate = {
    keys: Array<Heading & { facet?: boolean }>;
    metrics: Heading[];
    groups: Group[];
    notes: string[];
  };

  /** A column of points: numbers, or categories by their codes (-1: none). */
  type Axis = Heading & { values?: Numbers; codes?: number[]; categories?: Value[] };
  type Points = {
    count: number;
    axes: { x: Axis; y: Axis; colour?: Axis; facet?: Axis };
    status: { kind: string; codes: number[]; categories: string[] };
    id: number[];
    uid: string[] | null;
    run: Value[] | null;
    mixed: Array<{ sentence: string }>;
    notes: string[];
  };

  type Curve = {
    keys: Keys;
    runs: number;
    total: number;
    n: number;
    failures: Failures;
    leftOut: Failures;
    median: number | null;
    x: number[];
    share: number[];
  };
  type Ecdf = {
    metric: Heading;
    keys: Array<Heading & { facet?: boolean }>;
    competitors: number;
    shown: number;
    curves: Curve[];
    notes: string[];
  };

  /** The runs at a place of one setting or two, failed ones ranked last: null figures are failed runs'. */
  type SurfaceCell = {
    at: Value[];
    runs: number;
    total: number;
    n: number;
    failures: Failures;
    best: number | null;
    low: number | null;
    median: number | null;
    high: number | null;
  };
  type SurfaceBoard = { keys: Keys; cells: SurfaceCell[] };
  type Surface = { metric: Heading; axes: Heading[]; boards: SurfaceBoard[]; notes: string[] };
  type SliceBoard = { keys: Keys; slices: Record<string, SurfaceCell[]> };
  type Slices = { metric: Heading; settings: Heading[]; boards: SliceBoard[]; notes: string[] };

  type CommonEntry = {
    keys: Keys;
    runs: number;
    n: number;
    own: number | null;
    ownRank: number;
    common: number | null;
    rank: number;
  };
  type CommonRun = {
    uid: string;
    run: Value;
    status: string;
    coverage: number | null;
    common: number | null;
    own: number | null;
    poses: number | null;
    scale: number | null;
    problem: string | null;
  };
  type Support = { spans: number[][]; seconds: number; metres: number; share: number };
  type CommonGroup = {
    facets: Keys;
    support: Support | null;
    entries: CommonEntry[];
    runs: CommonRun[];
    notes: string[];
  };
  type Common = { by: string[]; groups: CommonGroup[]; notes: string[] };

  type Pair = {
    a: Keys;
    b: Keys;
    n: number;
    wins: { a: number; b: number; ties: number };
    effect: number | null;
    ratio: number | null;
    ratioInterval: Interval | null;
    p: number | null;
    pHolm: number | null;
    sentence: string;
  };
  type Compare = {
    metric: Heading;
    by: string[];
    boards: Array<{ facets: Keys; competitors: number; shown: number; pairs: Pair[] }>;
    notes: string[];
  };

  type Subject = {
    keys: Keys;
    runs: number;
    n: number;
    parameters: Array<{ name: string; variance: number | null }>;
    interactions: Array<{ a: string; b: string; variance: number | null }>;
    unexplained: number | null;
  };
  type Trial = {
    number: number;
    values: Record<string, any>;
    state: string;
    origin: string;
    told: number;
    runs: number;
    spared: number;
    judged: number;
    figures: Array<number | null>;
    failed: number | null;
    dropped: string | null;
    at: number;
  };
  type SweepSearch = {
    method: string;
    objectives: Array<{ metric: string; goal: string }>;
    metrics: Heading[];
    axes: Array<{ label: string; log: boolean }>;
    titles: string[];
    contexts: Array<Record<string, any>>;
    block: number;
    averaged: string;
    trials: Trial[];
    history: Array<{ runs: number; best: number[] }>;
    best: number[];
    influences: Array<{ axis: string; shares: number[]; groups: number }>;
    compared: number;
    leastCompared: number;
    most: number;
    ended: number;
    computed: number;
    spared: number;
    wanted: number;
    toCome: number;
    expected: number;
    secondsLeft: number | null;
    over: boolean;
    message: string;
  };

  type Importance = { metric: Heading; subjects: Subject[]; notes: string[] };

  type Score = {
    dataset: string;
    runs: number;
    n: number;
    copies: number;
    failures: Failures;
    median: number | null;
    medianFailed: boolean;
    rank: number | null;
    summary: Figure | null;
    coverage: number | null;
  };
  type Ranked = {
    keys: Keys;
    rank: number | null;
    unranked: string;
    rankInterval: Interval | null;
    score: number | null;
    ratio: number | null;
    ratioInterval: Interval | null;
    ratioFailed: boolean;
    runs: number;
    n: number;
    copies: number;
    failed: number;
    datasets: Score[];
  };
  type Board = { facets: Keys; datasets: string[]; entries: Ranked[] };
  type Leaderboard = {
    metric: Heading;
    by: string[];
    pooled: Record<string, number>;
    /** Algorithms whose rows are over a setting, where not all are. */
    whose: Record<string, string[]>;
    boards: Board[];
    /** Causal and final errors, latencies; null where no run was played to. */
    timely: (Aggregate & { words: string }) | null;
    notes: string[];
  };

  type ParetoPoint = {
    keys: Keys;
    x: number | null;
    y: number | null;
    yFailed: boolean;
    xRange: Numbers;
    yRange: Numbers;
    front: boolean;
    runs: number;
    n: number;
    failed: number;
    failures: Failures;
    coverage: number | null;
  };
  type ParetoFront = { facets: Keys; points: ParetoPoint[] };
  type Pareto = { x: Heading; y: Heading; by: string[]; fronts: ParetoFront[]; notes: string[] };

  type Repeated = {
    keys: Keys;
    runs: number;
    n: number;
    copies: number;
    failed: number;
    failures: Failures;
    coverage: Figure | null;
    distinct: number | null;
    deterministic: boolean;
    figure: Figure | null;
    relativeSpread: number | null;
    verdict: string;
  };
  type Repeatability = { metric: Heading; groups: Repeated[]; notes: string[] };

  type ThresholdCell = {
    status: string;
    falls: boolean | null;
    passing: number | null;
    failing: number | null;
    sure: Array<number | null>;
    sentence: string;
    runs: number;
    values: { value: number; failed: number; known: number; share: number | null }[];
  };
  type Robustness = {
    axes: Heading[];
    systems: { keys: Keys; cells: (ThresholdCell | null)[] }[];
    notes: string[];
  };

  type Suspect = { keys: Keys; scale: number; spread: number; n: number; sentence: string };
  type Suspects = { items: Suspect[]; notes: string[] };
  type NodeStanding = {
    node: string;
    kind: string;
    others: number;
    settings: number;
    runs: number;
    ratio: number;
    low: number | null;
    high: number | null;
    verdict: string;
    sentence: string;
  };
  type Nodes = { items: NodeStanding[]; notes: string[] };
  type SuspectStretch = {
    begin: number;
    end: number;
    metres: number;
    direction: [number, number, number];
    spread: number;
    ratio: number;
  };
  type Suspicion = {
    systems: string[];
    instants: number;
    seconds: number;
    stretches: SuspectStretch[];
    rmse: Record<string, number | null>;
    rmseWithout: Record<string, number | null>;
    limit: number;
    profile: Array<[number, number, number]>;
  };
  type TruthSuspect = {
    dataset: string;
    runs: number;
    why: string | null;
    leftOut: string[];
    found: Suspicion | null;
  };
  type TruthSuspects = { items: TruthSuspect[]; notes: string[] };

  type Side = {
    runs: number;
    n: number;
    failures: Failures;
    median: number | null;
    medianFailed: boolean;
    points: number[];
    deterministic: boolean;
  };
  type Setting = { keys: Keys; before: Side; after: Side; ratio: number | null };
  type Version = { version: string | null; runs: number; first: string | null; last: string | null };
  type Change = {
    changed: string;
    keys: Keys;
    before: Version;
    after: Version;
    current: boolean;
    n: number;
    settings: Setting[];
    unpaired: number;
    ratio: number | null;
    wins: { better: number; worse: number; same: number };
    deterministic: boolean;
    test: string | null;
    p: number | null;
    pHolm: number | null;
    leastP: number | null;
    differences: Array<{ column: string; before: Value[]; after: Value[] }>;
    sentence: string;
  };
  type Versions = { metric: Heading; changes: Change[]; notes: string[] };
}
