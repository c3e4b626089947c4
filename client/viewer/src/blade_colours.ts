/** The page's own blade; then those of others, by their source. Told apart in both themes. */
const kOwn = 0x39d0c0;
const kOthers = [0xffb84d, 0xb08cff, 0x5aa9ff, 0xff7eb6, 0xb5d94c, 0xff7a59, 0x66d9ff, 0xf2d64b];

export const colourOf = (source: number, own: boolean): number => (own ? kOwn : kOthers[source % kOthers.length]);
export const cssColour = (source: number, own: boolean): string =>
  `#${colourOf(source, own).toString(16).padStart(6, "0")}`;

/** What blades are called, by their source. */
export class BladeNames {
  private names = new Map<number, string>();

  /** json: the server's statistics; what they do not say is kept. */
  read(json: string): void {
    try {
      const { blades } = JSON.parse(json) as { blades?: { source: number; name: string }[] };
      for (const { source, name } of blades ?? []) this.names.set(Number(source), String(name));
    } catch {
      // The figures say so.
    }
  }

  /** Under which name this page cuts: a session without a server has no statistics of blades. */
  set(source: number, name: string): void {
    this.names.set(source, name);
  }

  of(source: number): string {
    return this.names.get(source) || `blade ${source + 1}`;
  }
}
