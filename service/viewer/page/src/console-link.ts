// The page's end of the bridge: the session, orders and their answers, events, and what is said when it breaks.

export class OrderError extends Error {
  constructor(message: string, readonly code: string) { super(message); }
}

export type State = "connecting" | "open" | "lost" | "login" | "stale";
interface Answer { id?: number | null; result?: unknown; error?: string; code?: string; event?: string; refused?: string }
interface Waiting { resolve(result: unknown): void; reject(error: OrderError): void }

// A page whose address ends in #slow is on a slow line: few points, one measured pose a second, lists seldom.
export const IS_SLOW = location.hash === "#slow";
const FEW_POINTS = 1500;
export const points = (): Record<string, number> => (IS_SLOW ? { most_points: FEW_POINTS } : {});

const ENDED = 4401;
const OTHER_VERSION = 4409;
const AGAIN_MS = [300, 1000, 2000, 4000];

export class Link {
  onState: (state: State, why: string) => void = () => {};
  onEvent: (event: Record<string, unknown>) => void = () => {};
  state: State = "connecting";
  private socket: WebSocket | null = null;
  private number = 0;
  private tries = 0;
  private readonly waiting = new Map<number, Waiting>();

  constructor(private readonly version: string) {}

  // Find the session of this browser, and open the bridge; where there is none, the operator logs in.
  async start(): Promise<void> {
    this.tell("connecting", "");
    try {
      const reply = await fetch("/session", { method: "POST" });
      await this.enter(reply);
    } catch (error) {
      if (error instanceof OrderError && error.code === "UNAUTHENTICATED") this.tell("login", "");
      else this.lose(error instanceof OrderError ? error.message : "the console does not answer");
    }
  }

  // Begin a session with a token; throws what the server says of it.
  async logIn(token: string): Promise<void> {
    const reply = await fetch("/login", { method: "POST", body: JSON.stringify({ token }), headers: { "content-type": "application/json" } });
    await this.enter(reply);
  }

  // End the session; the page is loaded again afterwards, and keeps nothing of it.
  async logOut(): Promise<void> {
    this.state = "login";
    this.socket?.close();
    await fetch("/logout", { method: "POST" });
  }

  private async enter(reply: Response): Promise<void> {
    const said = (await reply.json()) as { forgery?: string; version?: string; error?: string; code?: string };
    if (!reply.ok || said.forgery === undefined) throw new OrderError(said.error ?? "the console does not answer", said.code ?? "");
    if (said.version !== this.version) return this.tell("stale", "this page is of another version than the console; load it again");
    this.open(said.forgery);
  }

  private open(forgery: string): void {
    const socket = new WebSocket(`${location.protocol === "https:" ? "wss" : "ws"}://${location.host}/orders`);
    this.socket = socket;
    let why = "the connection to the console was lost";
    socket.onopen = () => socket.send(JSON.stringify({ hello: { version: this.version, forgery, is_slow: IS_SLOW } }));
    socket.onmessage = (message) => {
      const answer = JSON.parse(message.data as string) as Answer;
      if (answer.refused !== undefined) why = answer.refused;
      else if (answer.event === "hello") {
        this.tries = 0;
        this.tell("open", "");
        this.onEvent(answer as Record<string, unknown>);
      } else if (answer.event !== undefined) this.onEvent(answer as Record<string, unknown>);
      else this.settle(answer);
    };
    socket.onclose = ({ code }) => {
      for (const { reject } of this.waiting.values()) reject(new OrderError("the connection to the console was lost before it answered", "UNAVAILABLE"));
      this.waiting.clear();
      if (this.state === "login") return;
      if (code === OTHER_VERSION) this.tell("stale", why);
      else if (code === ENDED) void this.start();
      else this.lose(why);
    };
  }

  private settle(answer: Answer): void {
    const waiting = this.waiting.get(answer.id ?? -1);
    if (!waiting) return;
    this.waiting.delete(answer.id!);
    if (answer.error !== undefined) waiting.reject(new OrderError(answer.error, answer.code ?? ""));
    else waiting.resolve(answer.result);
  }

  // Give an order; the answer is its result, or an error that says in a sentence why it was not carried out.
  order<T>(name: string, values: Record<string, unknown> = {}): Promise<T> {
    if (this.state !== "open" || !this.socket) return Promise.reject(new OrderError("there is no connection to the console", "UNAVAILABLE"));
    const id = ++this.number;
    this.socket.send(JSON.stringify({ ...values, id, order: name }));
    return new Promise<T>((resolve, reject) => this.waiting.set(id, { resolve, reject }));
  }

  // Told again and again until it answers.
  private lose(why: string): void {
    this.tell("lost", why);
    setTimeout(() => void this.start(), AGAIN_MS[Math.min(this.tries++, AGAIN_MS.length - 1)]);
  }

  private tell(state: State, why: string): void {
    this.state = state;
    this.onState(state, why);
  }
}
