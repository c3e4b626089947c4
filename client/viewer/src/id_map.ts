const kEmpty = 0xffffffff;

/** From 32-bit ids (below 2^32 - 1) to slots: open addressing in two typed arrays. A Map takes ten times the memory
 * and loads the garbage collector. */
export class IdMap {
  private keys = new Uint32Array(1024).fill(kEmpty);
  private slots = new Uint32Array(1024);
  private used = 0;

  get size(): number {
    return this.used;
  }

  /** The slot of an id, or -1. */
  get(id: number): number {
    const mask = this.keys.length - 1;
    for (let i = this.place(id); ; i = (i + 1) & mask) {
      if (this.keys[i] === id) return this.slots[i];
      if (this.keys[i] === kEmpty) return -1;
    }
  }

  /** `id` must not be in the map. */
  add(id: number, slot: number): void {
    if (2 * ++this.used > this.keys.length) this.grow();
    const mask = this.keys.length - 1;
    let i = this.place(id);
    while (this.keys[i] !== kEmpty) i = (i + 1) & mask;
    this.keys[i] = id;
    this.slots[i] = slot;
  }

  /** `id` must be in the map. Later entries move up, so that a search can stop at the first empty place. */
  remove(id: number): void {
    const mask = this.keys.length - 1;
    let gap = this.place(id);
    while (this.keys[gap] !== id) gap = (gap + 1) & mask;
    for (let i = (gap + 1) & mask; this.keys[i] !== kEmpty; i = (i + 1) & mask) {
      if (((i - this.place(this.keys[i])) & mask) < ((i - gap) & mask)) continue;
      this.keys[gap] = this.keys[i];
      this.slots[gap] = this.slots[i];
      gap = i;
    }
    this.keys[gap] = kEmpty;
    --this.used;
  }

  clear(): void {
    this.keys.fill(kEmpty);
    this.used = 0;
  }

  private place(id: number): number {
    return (Math.imul(id, 0x9e3779b1) >>> 7) & (this.keys.length - 1);
  }

  private grow(): void {
    const { keys, slots } = this;
    this.keys = new Uint32Array(2 * keys.length).fill(kEmpty);
    this.slots = new Uint32Array(2 * keys.length);
    const mask = this.keys.length - 1;
    for (let i = 0; i < keys.length; ++i) {
      if (keys[i] === kEmpty) continue;
      let j = this.place(keys[i]);
      while (this.keys[j] !== kEmpty) j = (j + 1) & mask;
      this.keys[j] = keys[i];
      this.slots[j] = slots[i];
    }
  }
}
