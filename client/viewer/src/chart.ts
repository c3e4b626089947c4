const kSeconds = 30;

/** A small chart of the last half minute. Draws only when it gets a value. */
export class Chart {
  private readonly values: number[] = [];

  /** `least` is the smallest range of the axis, so that noise does not look like a peak. Above `limit` something is wrong. */
  constructor(
    private readonly canvas: HTMLCanvasElement,
    private readonly least: number,
    private readonly perSecond = 2,
    private readonly limit = Infinity,
  ) {}

  /** `shown` is the figure beside the chart, which is marked above the limit: it may outlast the value. */
  push(value: number, shown = value): void {
    this.values.push(Number.isFinite(value) ? value : 0);
    if (this.values.length > kSeconds * this.perSecond) this.values.shift();
    this.canvas.dataset.over = String(shown > this.limit);
    this.draw();
  }

  clear(): void {
    this.values.length = 0;
    this.draw();
  }

  draw(): void {
    const { canvas } = this;
    const width = canvas.clientWidth,
      height = canvas.clientHeight;
    if (width === 0) return;
    const ratio = Math.min(2, devicePixelRatio);
    if (canvas.width !== width * ratio) {
      canvas.width = width * ratio;
      canvas.height = height * ratio;
    }
    const g = canvas.getContext("2d")!;
    g.setTransform(ratio, 0, 0, ratio, 0, 0);
    g.clearRect(0, 0, width, height);
    const style = getComputedStyle(canvas);
    const colour = style.getPropertyValue("--chart");
    const top = Math.max(this.least, ...this.values) * 1.08;
    const count = kSeconds * this.perSecond;
    const x = (i: number) => width - ((this.values.length - 1 - i) / (count - 1)) * width;
    const y = (v: number) => height - 1.5 - (v / top) * (height - 4);
    g.fillStyle = style.getPropertyValue("--line");
    g.fillRect(0, height - 1, width, 1);
    if (this.limit <= top) {
      g.fillStyle = style.getPropertyValue("--bad");
      for (let dash = 0; dash < width; dash += 6) g.fillRect(dash, y(this.limit) - 0.5, 3, 1);
    }
    if (this.values.length < 2) return;
    g.beginPath();
    for (const [i, v] of this.values.entries()) g.lineTo(x(i), y(v));
    g.strokeStyle = colour;
    g.lineWidth = 1.5;
    g.lineJoin = "round";
    g.stroke();
    g.lineTo(width, height);
    g.lineTo(x(0), height);
    g.globalAlpha = 0.16;
    g.fillStyle = colour;
    g.fill();
    g.globalAlpha = 1;
  }
}
