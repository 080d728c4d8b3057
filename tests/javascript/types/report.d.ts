// SPDX-License-Identifier: Apache-2.0
/** What slamhive_eval/reports/report.py writes into the evaluator's HTML report. */
declare namespace Report {
  type Box = Record<'low' | 'q1' | 'median' | 'q3' | 'high' | 'max', number>;
  type Statistics = Record<string, number>;
  type Relative = { count: number; ranked: boolean; rmse?: number; rotationDeg?: { rmse?: number } };

  /** Of an estimate without errors, `time` is empty and all that is drawn is missing. */
  type Estimate = {
    name: string;
    outcome: string;
    message: string | null;
    coverage: number;
    scale: number | null;
    notes: string[];
    poses: number;
    statistics: Record<string, Statistics | null>;
    rpe: Relative[];
    path: number[][];
    breaks: number[];
    thinned: boolean;
    time: number[];
    distance: number[];
    errors: Record<string, number[]>;
    histogram: Record<string, number[]>;
    box: Record<string, Box>;
  };
  type Data = {
    title: string;
    kinds: Record<string, { name: string; unit: string }>;
    edges: Record<string, number[]>;
    reference: { name: string; path: number[][]; breaks: number[] };
    estimates: Estimate[];
  };

  /** From values to places in a panel. */
  type Scale = {
    x: (value: number) => number;
    y: (value: number) => number;
    x0: number;
    x1: number;
    bottom: number;
  };
}
