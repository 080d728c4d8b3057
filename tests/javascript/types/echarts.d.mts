// SPDX-License-Identifier: Apache-2.0
/** What the pages use of ECharts; its options are objects that ECharts itself judges. */

export type Instance = {
  group: string;
  setOption(option: object, settings?: { notMerge?: boolean }): void;
  resize(): void;
  dispose(): void;
  on(name: string, handler: (event: any) => void): void;
  dispatchAction(action: object): void;
  getDataURL(settings: object): string;
  renderToSVGString(): string;
};

export function init(box: HTMLElement | null, theme: null, settings: object): Instance;
export function connect(group: string): void;
